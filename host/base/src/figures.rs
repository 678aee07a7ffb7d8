//! Figures of error as reports hold them.

use std::collections::BTreeMap;

use serde::Serialize;

/// One error with what it was taken over and what it depends on.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ErrorFigure {
    /// Name, such as `held_out_log_rms`.
    pub name: String,
    /// Value.
    pub value: f64,
    /// Unit; `1` for a ratio.
    pub unit: String,
    /// What the error was taken over: texels, held-out samples.
    pub over: String,
    /// What it depends on: `lobes`, `wavelength_nm`, `method`, `residual`, …
    #[serde(flatten)]
    pub depends: BTreeMap<String, serde_json::Value>,
}

impl ErrorFigure {
    /// A figure that depends on nothing yet.
    pub fn new(name: &str, value: f64, unit: &str, over: impl Into<String>) -> Self {
        Self { name: name.into(), value, unit: unit.into(), over: over.into(), depends: BTreeMap::new() }
    }

    /// Adds what the figure depends on.
    #[must_use]
    pub fn with(mut self, key: &str, value: impl Into<serde_json::Value>) -> Self {
        self.depends.insert(key.into(), value.into());
        self
    }
}
