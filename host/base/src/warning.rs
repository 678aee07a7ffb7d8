//! What a person needs to know before a measurement or a fit is trusted: each warning is one line on the
//! terminal and an entry of the report.
//!
//! What finds them stands with what it looks at: samples by pose, predicted, photographed or stored; where
//! light and camera stood; poses and texels that a fit leaves much of.

use serde::Serialize;

/// What a warning is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// Samples that are saturated in every exposure.
    Clipped,
    /// Samples darker than their noise.
    Starved,
    /// Samples that are not numbers: outside the photograph, or unlit.
    Missing,
    /// Poses of which it is not known where light or camera stood.
    UnknownPose,
    /// Poses and frames that are left out, because they are not what the run says.
    LeftOut,
    /// A run that lasts longer than the lamp may burn.
    LampTime,
    /// Fewer poses than unknowns.
    FewPoses,
    /// Directions that do not determine the shape of a lobe.
    Shape,
    /// Texels with a residual that their noise does not explain.
    UnexplainedTexels,
    /// Regions of a pooled fit of which no sample was fitted.
    EmptyRegion,
    /// Poses with a residual far above that of the others.
    OutstandingPose,
}

/// One warning.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Warning {
    /// What it is about.
    pub kind: Kind,
    /// One line: what is wrong, where, and what to do.
    pub text: String,
    /// The poses concerned, the worst first, numbered from 0 as files number them.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub poses: Vec<usize>,
    /// Number of texels concerned.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub texels: Option<usize>,
}

impl Warning {
    /// A warning that concerns neither poses nor texels by number.
    pub fn new(kind: Kind, text: impl Into<String>) -> Self {
        Self { kind, text: text.into(), poses: Vec::new(), texels: None }
    }
}

/// The poses of a list that are named on the terminal; the report has all.
pub const NAMED: usize = 5;

/// `pose 3 (57 %)`, or `poses 3 (57 %), 8 (41 %) and 12 more`, each pose with a remark.
pub fn named(poses: &[(usize, String)]) -> String {
    let list: Vec<String> =
        poses.iter().take(NAMED).map(|(pose, remark)| format!("{pose} ({remark})")).collect();
    let more = poses.len().saturating_sub(NAMED);
    match (list.as_slice(), more) {
        ([one], _) => format!("pose {one}"),
        ([first @ .., last], 0) => format!("poses {} and {last}", first.join(", ")),
        (list, more) => format!("poses {} and {more} more", list.join(", ")),
    }
}

/// A share in percent, with a digit after the point below 10 %.
pub fn percent(share: f64) -> String {
    let percent = 100.0 * share;
    if percent < 9.95 { format!("{percent:.1} %") } else { format!("{percent:.0} %") }
}

/// The middle one of some values, which are reordered; NaN without any.
pub fn median(values: &mut [f64]) -> f64 {
    quantile(values, 0.5)
}

/// The quantile of some values, which are reordered; NaN without any.
pub fn quantile(values: &mut [f64], share: f64) -> f64 {
    if values.is_empty() {
        return f64::NAN;
    }
    let place = ((values.len() - 1) as f64 * share).round() as usize;
    *values.select_nth_unstable_by(place, f64::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn poses_are_listed_as_a_sentence_needs_them() {
        let list = |count: usize| -> Vec<(usize, String)> { (0..count).map(|k| (k, "x".into())).collect() };
        assert_eq!(named(&list(1)), "pose 0 (x)");
        assert_eq!(named(&list(3)), "poses 0 (x), 1 (x) and 2 (x)");
        assert_eq!(named(&list(7)), "poses 0 (x), 1 (x), 2 (x), 3 (x), 4 (x) and 2 more");
    }

    #[test]
    fn quantiles_are_values_of_the_list() {
        assert_eq!(median(&mut [3.0, 1.0, 2.0]), 2.0);
        assert_eq!(quantile(&mut [5.0, 1.0, 2.0, 4.0, 3.0], 1.0), 5.0);
        assert!(median(&mut []).is_nan());
    }
}
