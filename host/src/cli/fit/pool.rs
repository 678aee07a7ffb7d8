//! `lobelia fit --pool INDEX.png`: one BRDF a region.

use std::path::Path;
use std::time::Instant;

use super::words::{albedos, residuals, ties};
use super::{
    Findings, FitArgs, Summary, Tally, held_out, output, print, rate, unexplained_in_words, write_map,
};
use crate::edit::palette;
use crate::error::Result;
use crate::fit::FitOptions;
use crate::fit::held_out::HeldOut;
use crate::fit::pool::regions::Regions;
use crate::fit::pool::{self, PoolOptions, RegionReport};
use crate::progress::counted;
use crate::sampled::SampledStore;
use crate::warning::texels;

/// Regions that are told one by one on the terminal; the report has all.
const TOLD: usize = 24;

/// A colour on the command line.
pub(super) fn parse_colour(text: &str) -> std::result::Result<[u8; 3], String> {
    let grey = text.parse::<u8>().ok().map(|grey| [grey; 3]);
    grey.or_else(|| palette::parse_hex(text))
        .ok_or_else(|| "must be a colour such as #a0b1c2 or a grey value from 0 to 255".into())
}

/// Fits the regions, writes the map and tells what came of each; the samples are counted.
///
/// # Errors
/// As [`pool::fit_store_counted`] and [`Regions::read`]; when the map cannot be written.
pub(super) fn fit(
    args: &FitArgs,
    store: &SampledStore,
    options: &FitOptions,
    index: &Path,
    held: Option<&HeldOut>,
    seed: u64,
    tally: &Tally,
) -> Result<Findings> {
    let output = output(args)?;
    let rho_d = args.rho_d();
    let pooling = PoolOptions { rho_d, most_samples: args.pool_samples, seed };
    pool::check(options, &pooling)?;
    let regions = Regions::read(index, [store.width, store.height], args.pool_outside)?;
    let start = Instant::now();
    let mut pooled = pool::fit_store_counted(store, &regions, options, &pooling, tally)?;
    let seconds = start.elapsed().as_secs_f64();
    held.iter().for_each(|held| held.note(&mut pooled.map));
    pooled.map.attributes.extend(args.made.clone());
    write_map(&pooled.map, output, args.encoding())?;
    let summary = Summary::new(&pooled.map);
    let mut outcome = Findings::of_map(&pooled.map, &summary);
    rate(&mut outcome, summary.texels, seconds);
    let outside = regions.of.iter().filter(|region| region.is_none()).count();
    outcome.figures.insert("texels_outside_regions".into(), outside.into());
    outcome.figures.insert("regions".into(), pooled.regions.iter().map(as_json).collect());
    let held_out = held_out::judge(held, store, &pooled.map, &mut outcome)?;
    outcome.warnings.extend(texels::empty_regions(&pooled.regions));
    outcome.add_texels(&pooled.map);
    print(&format!(
        "{} × {} in {}, a ρ_d a {}: {seconds:.1} s\n{}{}",
        counted((regions.of.len() - outside) as u64, "texel", "texels"),
        counted(store.poses.len() as u64, "pose", "poses"),
        counted(pooled.regions.len() as u64, "region", "regions"),
        pooling.rho_d.name(),
        regions_in_words(&pooled.regions),
        residuals(&summary)
            + &held_out
            + &albedos(&summary)
            + &ties(&summary)
            + &unexplained_in_words(&pooled.map)
    ))?;
    Ok(outcome)
}

fn as_json(region: &RegionReport) -> serde_json::Value {
    serde_json::json!({
        "region": region.name,
        "texels": region.texels,
        "samples": region.samples,
        "samples_fitted": region.fitted,
        "lobes": region.lobes,
        "rms_per_sr": region.rms,
        "rms_relative": region.relative,
        "texels_bounded": region.bounded,
    })
}

/// A line a region.
fn regions_in_words(regions: &[RegionReport]) -> String {
    let line = |region: &RegionReport| {
        let of = if region.fitted < region.samples {
            format!("{} of {} samples", region.fitted, region.samples)
        } else {
            counted(region.samples as u64, "sample", "samples")
        };
        format!(
            "region {}: {}, {of}, {}, RMS {:.3e} 1/sr, {:.2} % of the samples'\n",
            region.name,
            counted(region.texels as u64, "texel", "texels"),
            counted(region.lobes as u64, "lobe", "lobes"),
            region.rms,
            100.0 * region.relative
        )
    };
    let mut text: String = regions.iter().take(TOLD).map(line).collect();
    if regions.len() > TOLD {
        text += &format!(
            "and {} more, which --report tells\n",
            counted((regions.len() - TOLD) as u64, "region", "regions")
        );
    }
    text
}
