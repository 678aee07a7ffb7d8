//! What a plan costs and gives, by its density: poses, travel, the largest gap, the sharpest lobe that it
//! resolves.

use super::{Axis, Chart, Plot, Section, Series, Table};
use crate::error::Result;
use crate::plan::{self, Extent, density, order};
use crate::progress;
use crate::rig::config::RigConfig;

/// Spacings that are planned for isotropic materials, degrees, widest first: the narrowest takes longest.
const ISOTROPIC_DEG: [f64; 6] = [25.0, 20.0, 15.0, 12.0, 10.0, 8.0];
/// For anisotropic ones, whose direction pairs have a dimension more.
const ANISOTROPIC_DEG: [f64; 5] = [40.0, 35.0, 30.0, 25.0, 20.0];

/// Plans a rig at several densities, for isotropic and for anisotropic materials.
///
/// # Errors
/// When the rig is no valid one or reaches no pose.
pub fn chart(rig: &RigConfig, seed: u64) -> Result<Chart> {
    let bar = progress::bar("planning", (ISOTROPIC_DEG.len() + ANISOTROPIC_DEG.len()) as u64, "plans");
    let mut table =
        Table::new(["material", "spacing, °", "poses", "travel, s", "sharpest exponent resolved"]);
    let (mut by_spacing, mut by_exponent) = (Vec::new(), Vec::new());
    let materials: [(_, &[f64]); 2] = [("isotropic", &ISOTROPIC_DEG), ("anisotropic", &ANISOTROPIC_DEG)];
    for (material, spacings) in materials {
        let isotropic = material == "isotropic";
        let (mut poses, mut travels) = (Vec::new(), Vec::new());
        for &spacing_deg in spacings {
            let plan = plan::make(rig, Extent::Density(spacing_deg), isotropic, seed)?;
            let angles: Vec<_> = (0..plan.poses.len()).map(|index| plan.angles(index)).collect();
            let travel_s = order::tour_s(rig, &angles);
            let sharpest = density::sharpest(spacing_deg.to_radians(), isotropic);
            poses.push([spacing_deg, angles.len() as f64]);
            travels.push([sharpest, travel_s]);
            table.row([
                material.into(),
                spacing_deg.into(),
                angles.len().into(),
                travel_s.into(),
                sharpest.into(),
            ]);
            bar.advance(1);
        }
        by_spacing.push(Series::new(material, poses));
        by_exponent.push(Series::new(material, travels));
    }
    let plot = |title: &str, x, y: &str, series| Plot { title: title.into(), x, y: Axis::log(y), series };
    let section = Section {
        title: "Poses and travel by density".into(),
        text:
            "Exponent: the sharpest lobe cosⁿ with four poses inside its highlight, by (3.5) for isotropic \
             and (3.6) for anisotropic materials. Travel is the axes' time alone, without exposures."
                .into(),
        plots: vec![
            plot("Poses by spacing", Axis::log("bi-angular spacing, °"), "poses", by_spacing),
            plot(
                "Travel by the sharpest lobe that is resolved",
                Axis::log("exponent n"),
                "travel, s",
                by_exponent,
            ),
        ],
        tables: vec![table],
        ..Section::default()
    };
    Ok(Chart {
        name: "plan".into(),
        title: "What a plan costs".into(),
        lead: "The rig's poses were chosen and ordered at several densities.".into(),
        sections: vec![section],
    })
}
