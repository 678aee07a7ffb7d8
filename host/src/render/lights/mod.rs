//! stub
use super::Rendering;
use crate::{Result, scene::Scene};
#[derive(Default)]
pub struct Settings;
pub fn render(_s: &Scene, _x: &Settings) -> Result<Rendering> {
    Err(crate::Error::failure("stub"))
}
