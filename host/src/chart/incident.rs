//! Near lights by samples of incident radiance: ways to place and to blend samples against a sample at every
//! vertex, in the shape of the source's tables 4.1 to 4.4.

use super::{Axis, Chart, Plot, Section, Series, Table};
use crate::error::Result;
use crate::progress;
use crate::render::incident::{Oracle, Outcome, Sampling, Settings, Study};
use crate::scene::Scene;

/// Errors that the method's own way is asked for, over the root mean square of radiance.
const EPSILONS: [f64; 6] = [0.2, 0.1, 0.05, 0.02, 0.01, 0.005];
/// Samples of quantisation.
const COUNTS: [usize; 4] = [32, 64, 128, 256];
/// Exponents of its weights.
const EXPONENTS: [f32; 4] = [1.0, 2.0, 4.0, 8.0];
/// Samples beyond which a published oracle's bound is not lowered any more.
const ENOUGH: usize = 2000;

/// The chart of some scenes, at a degree of the spherical harmonics.
///
/// # Errors
/// Those of the method.
pub fn chart(scenes: &[(String, Scene)], degree: u32) -> Result<Chart> {
    let settings = Settings { degree, ..Settings::default() };
    let of_scene = |(name, scene): &(String, Scene)| -> Result<Section> {
        let study = Study::new(scene, &settings)?;
        Ok(section(name, &study, degree))
    };
    Ok(Chart {
        name: "incident".into(),
        title: "Near lights by samples of incident radiance".into(),
        lead:
            "What samples of incident radiance cost, and how far the colours that they give are from those \
             of a sample at every vertex of the same degree: root mean square over vertices and channels, \
             over that of the colours themselves. Samples are all that were taken, the 64 checks of the own \
             way aside."
                .into(),
        sections: scenes.iter().map(of_scene).collect::<Result<_>>()?,
    })
}

/// One scene.
fn section(name: &str, study: &Study, degree: u32) -> Section {
    let ways = 2 + EPSILONS.len() + 6 + COUNTS.len() * EXPONENTS.len();
    let bar = progress::bar("sampling", ways as u64, "ways");
    let truth = study.sample(Sampling::Every, usize::MAX);
    let mut table = Table::new([
        "way",
        "setting",
        "samples",
        "kept",
        "sampling, s",
        "reconstruction, s",
        "relative RMSE",
    ]);
    let mut series: Vec<Series> = Vec::new();
    let mut add = |way: String, setting: String, outcome: &Outcome| {
        let error = outcome.rmse(&truth) / truth.rms();
        table.row([
            way.as_str().into(),
            setting.into(),
            outcome.samples.into(),
            outcome.kept.into(),
            outcome.sampling_seconds.into(),
            outcome.reconstruction_seconds.into(),
            error.into(),
        ]);
        let point = [outcome.samples as f64, error];
        match series.iter_mut().find(|series| series.name == way) {
            Some(series) => series.points.push(point),
            None => series.push(Series::new(way, vec![point])),
        }
    };
    let step = || bar.advance(1);
    add("every vertex".into(), String::new(), &truth);
    add("one sample".into(), String::new(), &study.sample(Sampling::One, 1));
    (0..2).for_each(|_| step());
    for epsilon in EPSILONS {
        let outcome = study.sample(Sampling::SecondOrder(epsilon), usize::MAX);
        add("second derivatives, smooth first order".into(), format!("ε {epsilon}"), &outcome);
        step();
    }
    let forms =
        [(Oracle::Printed, "r|l|/H²"), (Oracle::Product, "r²|l|/H"), (Oracle::ScaleFree, "(r/H)²|l|")];
    for (oracle, form) in forms {
        for (ancestors, kept) in [(true, "published"), (false, "published, leaves alone")] {
            let mut before = 0;
            for k in 0..24 {
                let epsilon = 10f64.powf(1.5 - f64::from(k) / 4.0);
                let published = Sampling::Published { oracle, epsilon, ancestors };
                let outcome = study.sample(published, 2 * ENOUGH);
                if outcome.samples > before.max(1) {
                    add(format!("{kept}, {form}"), format!("ε {epsilon:.4}"), &outcome);
                }
                before = outcome.samples;
                if before > ENOUGH {
                    break;
                }
            }
            step();
        }
    }
    for exponent in EXPONENTS {
        for count in COUNTS {
            let outcome = study.sample(Sampling::Quantised { exponent }, count);
            add(format!("quantised, b = {exponent}"), format!("{count}"), &outcome);
            step();
        }
    }
    Section {
        title: format!("{name}: {} vertices, degree {degree}", study.receivers()),
        text: "Vertices of open meshes count once a side. A published way is the source's: its oracle, \
             domains of the boxes' spheres, weights 1/d, the samples of nodes that were parted kept or not; \
             quantised is what it was compared with, all samples blended by 1/dᵇ."
            .into(),
        plots: vec![Plot {
            title: "Error against samples".into(),
            x: Axis::log("samples"),
            y: Axis::log("relative RMSE"),
            series,
        }],
        tables: vec![table],
        ..Section::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_way_has_its_row_and_the_own_one_errs_less_with_more_samples() {
        let mut scene = Scene::open("panels".as_ref()).unwrap();
        // The ball alone is enough.
        scene.objects.retain(|object| object.name == "ball");
        scene.lights.truncate(3);
        scene.objects[0].mesh = crate::scene::shapes::sphere(24, 12).into();
        let chart = chart(&[("ball".into(), scene)], 2).unwrap();
        let section = &chart.sections[0];
        let own = section.plots[0].series.iter().find(|series| series.name.starts_with("second")).unwrap();
        assert_eq!(own.points.len(), EPSILONS.len());
        assert!(own.points.windows(2).all(|pair| pair[1][0] >= pair[0][0]), "{:?}", own.points);
        assert!(own.points[5][1] < own.points[0][1]);
        let rows = &section.tables[0].rows;
        assert!(rows.len() > 2 + EPSILONS.len() + COUNTS.len() * EXPONENTS.len());
        assert_eq!(super::super::number(&rows[0][6]), Some(0.0));
    }
}
