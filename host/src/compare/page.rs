//! The page of a comparison.

use super::angles::Lattice;
use super::{ComparedPose, Comparison, Difference, shot};
use crate::by_angle::Side;
use crate::chart::{Axis, Chart, Picture, Plot, Section, Series, Table};
use crate::develop::Photographs;
use crate::error::Result;
use crate::page::numbers;
use crate::reflectance::SbrdfMap;

/// The chart of a comparison, with photograph, rendering and difference of the best, the median and the worst
/// pose.
///
/// # Errors
/// As [`super::poses`].
pub(super) fn chart(photographs: &Photographs, map: &SbrdfMap, comparison: &Comparison) -> Result<Chart> {
    let compared = &comparison.poses;
    let mut ranked: Vec<&ComparedPose> = compared.iter().collect();
    ranked.sort_by(|a, b| b.difference.psnr_db.total_cmp(&a.difference.psnr_db));
    let mut shown = vec![0, ranked.len() / 2, ranked.len() - 1];
    shown.dedup();
    let lattice = Lattice::over(map, &photographs.run.rig.carrier);
    let mut shots = Vec::new();
    for &rank in &shown {
        let pose = ranked[rank].pose;
        if let Ok(found) = shot(photographs, map, pose, (&lattice, None))? {
            let psnr = ranked[rank].difference.psnr_db;
            for (name, raster) in
                ["photograph", "rendering", "difference, ΔE 0 to 10"].iter().zip(found.pictures.rasters())
            {
                let title = format!("Pose {pose}, {psnr:.1} dB: {name}");
                shots.push(Picture { title, png: raster.png()? });
            }
        }
    }
    let mut table = Table::new(["pose", "half angle, °", "relative RMS", "PSNR, dB", "ΔE mean", "ΔE 95 %"]);
    for ComparedPose { pose, half_deg, difference } in compared {
        let [mean, most] = difference.delta_e;
        table.row([
            (*pose).into(),
            (*half_deg).into(),
            difference.relative_rms.into(),
            difference.psnr_db.into(),
            mean.into(),
            most.into(),
        ]);
    }
    let mut tables = vec![table];
    if !(comparison.left_out.is_empty() && comparison.notes.is_empty()) {
        let mut left_out = Table::new(["left out", "why"]);
        for (pose, why) in &comparison.left_out {
            left_out.row([format!("pose {pose}").into(), why.as_str().into()]);
        }
        comparison.notes.iter().for_each(|note| left_out.row(["".into(), note.as_str().into()]));
        tables.push(left_out);
    }
    let cylinder = photographs.run.rig.carrier.cylinder_radius_mm;
    let points = |value: fn(&Difference) -> f64| {
        let points = compared.iter().map(|pose| [pose.half_deg, value(&pose.difference)]).collect();
        let labels = compared.iter().map(|pose| format!("pose {}", pose.pose)).collect();
        vec![Series::scattered("poses", points, labels)]
    };
    let plot = |title: &str, y: Axis, value| Plot {
        title: title.into(),
        x: Axis::linear("angle between half vector and normal, °"),
        y,
        series: points(value),
    };
    let plots = vec![
        plot("Peak signal-to-noise ratio by half angle", Axis::linear("PSNR, dB"), |d| d.psnr_db),
        plot("Mean colour difference by half angle", Axis::linear("ΔE (CIEDE2000)"), |d| d.delta_e[0]),
    ];
    let section = Section {
        title: "Photographs and renderings".into(),
        text: format!(
            "The poses with the best, the median and the worst PSNR. A perfect diffuser {} is white; what is \
             brighter is clipped.",
            if cylinder.is_some() { "that faces the light" } else { "under the same light" }
        ),
        pictures: shots,
        ..Section::default()
    };
    let numbers = Section {
        title: "By pose".into(),
        text: "Relative RMS is of the linear radiance over the mosaic's pixels on the sample; PSNR and ΔE \
             are of the pictures as shown above."
            .into(),
        plots,
        tables,
        ..Section::default()
    };
    Ok(Chart {
        name: "compare".into(),
        title: "Photographs against the fitted map".into(),
        lead: format!(
            "Each pose was rendered from the fitted map with the rig's own camera and light, where the \
             photograph's registration puts the sample{}.",
            cylinder
                .map_or_else(String::new, |radius| format!(", bent over a cylinder of radius {radius} mm"))
        ),
        sections: vec![section, by_angle(comparison), numbers],
    })
}

/// Errors by angle, and what photographs there are to tell them.
fn by_angle(comparison: &Comparison) -> Section {
    let found = &comparison.by_angle;
    let cone = match &comparison.cone {
        None => {
            "It is not known which poses the map was fitted from, so that inside and outside of what was \
             measured are not told apart: --measured-in RUN names their run."
                .into()
        }
        Some(cone) => {
            let inside = format!(
                "Inside the measured cone a pose that the map was fitted from is within {}°, the spacing of \
                 its plan.",
                numbers::significant(cone.spacing_deg(), 3)
            );
            match found.side(Side::Outside) {
                None => format!(
                    "{inside} No photograph was taken outside, so that nothing is known of the \
                     map there."
                ),
                Some(_) => format!("{inside} Outside, the map tells what nobody measured."),
            }
        }
    };
    Section {
        title: "Inside and outside the measured cone".into(),
        text: format!(
            "‖rendered − photographed‖ / ‖photographed‖ of the reflectance over a texel’s pixels in all \
             photographs, noise included, by the directions at the texel; percentiles over the texels. {cone}"
        ),
        tables: vec![found.table()],
        ..Section::default()
    }
}
