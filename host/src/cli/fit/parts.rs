//! `lobelia fit --chunks I/N` and `--merge`: fits in parts, for schedulers to drive.

use std::path::{Path, PathBuf};
use std::time::Instant;

use super::args::{DeviceName, MethodName, ResidualName, WeightsName};
use super::words::residuals;
use super::{
    Findings, FitArgs, Summary, Tally, held_out, output, print, texel_options, write_levels, write_map,
};
use crate::error::{Error, Result};
use crate::files;
use crate::fit::chunks::{self, Part};
use crate::fit::held_out::HeldOut;
use crate::fit::request::Lobes;
use crate::fit::{FitOptions, MOST_LOBES};
use crate::progress::counted;
use crate::provenance::Texts;
use crate::reflectance::MapEncoding;
use crate::sampled::SampledStore;

impl FitArgs {
    /// The arguments with a sampled SBRDF that was named behind the shards taken for what it is: --merge
    /// takes all names up to the next option.
    pub(super) fn with_store_named_last(&self) -> Self {
        let mut args = self.clone();
        let is_store = |path: &PathBuf| files::ending(path) == "zarr";
        if args.input.is_none()
            && let Some(place) = args.merge.iter().position(is_store)
        {
            args.input = Some(args.merge.remove(place));
        }
        args
    }

    /// The options that a merge does not look at: it has the shards' fits as they are. --isotropic
    /// and --separate-channels say which held-out poses are near fitted ones, and with --mip all are those of
    /// the levels.
    fn of_no_merge(&self) -> Vec<&'static str> {
        if self.mip {
            return Vec::new();
        }
        let held = self.hold_out_poses.is_some();
        let given = [
            ("--lobes", self.lobes != Lobes::Auto(MOST_LOBES)),
            ("--model", self.model.is_some()),
            ("--normals", self.normals),
            ("--sharpening", self.sharpening),
            ("--method", self.method != MethodName::Auto),
            ("--residual", self.residual != ResidualName::Auto),
            ("--weights", self.weights != WeightsName::Auto),
            ("--robust", self.robust),
            ("--device", self.device != DeviceName::Auto),
            ("--isotropic", self.isotropic && !held),
            ("--separate-channels", self.separate_channels && !held),
            ("--diffuse-percentile", self.diffuse_percentile.is_some()),
            ("--conserve-energy", self.conserve_energy),
            ("--no-bound", self.no_bound),
            ("--wavelengths-nm", !self.wavelengths_nm.is_empty()),
            ("--hold-out-theta-deg", !self.hold_out_theta_deg.is_empty()),
            ("--hold-out-each-pair", self.hold_out_each_pair),
            ("--random-starts", self.random_starts > 0),
        ];
        given.into_iter().filter_map(|(name, given)| given.then_some(name)).collect()
    }
}

/// Fits one part into a shard, unless it is there already.
pub(super) fn fit(
    store: &SampledStore,
    options: &FitOptions,
    part: Part,
    held: Option<&HeldOut>,
    output: &Path,
    made: &Texts,
) -> Result<Findings> {
    let mut outcome = Findings::default();
    outcome.figures.insert("part".into(), part.to_string().into());
    if output.exists() {
        chunks::is_done(output, store, options, part)?;
        outcome.figures.insert("done_before".into(), true.into());
        print(&format!(
            "{}: shard {part} is there already, of these samples and options\n",
            output.display()
        ))?;
        return Ok(outcome);
    }
    let start = Instant::now();
    let tally = Tally::default();
    let mut shard = chunks::fit_part(store, options, part, &tally)?;
    shard.attributes.extend(made.clone());
    held.iter().for_each(|held| held.note(&mut shard));
    write_map(&shard, output, MapEncoding::Tiles)?;
    let seconds = start.elapsed().as_secs_f64();
    outcome.figures.insert("texels".into(), shard.width.into());
    outcome.figures.insert("texels_per_second".into(), (shard.width as f64 / seconds.max(1e-9)).into());
    print(&format!("{}: shard {part}, {} texels: {seconds:.1} s\n", output.display(), shard.width))?;
    outcome.add_samples(store, tally);
    Ok(outcome)
}

/// Joins shards into a map, which says what they say of how they were made, and fits its MIP levels where
/// they are asked for.
pub(super) fn merge(args: &FitArgs, seed: u64) -> Result<Findings> {
    let output = output(args)?;
    if let [first, others @ ..] = args.of_no_merge().as_slice() {
        let last = others.last().map_or_else(String::new, |last| format!(" and {last}"));
        let middle = others
            .split_last()
            .map_or_else(String::new, |(_, middle)| middle.iter().map(|name| format!(", {name}")).collect());
        return Err(Error::input(format!(
            "--merge joins shards as they were fitted, without {first}{middle}{last}: give that to each part \
             (--chunks)"
        )));
    }
    let mut store = args.input.as_deref().map(SampledStore::open).transpose()?;
    let held = match (&mut store, &args.hold_out_poses) {
        (Some(store), _) => held_out::hold_out(args, store, seed)?,
        (None, None) => None,
        (None, Some(_)) => {
            let message =
                "--hold-out-poses tells errors on samples: name the sampled SBRDF (.zarr) before --merge";
            return Err(Error::input(message));
        }
    };
    let map = chunks::merge(&args.merge, store.as_ref())?;
    let levels = match (&store, args.mip) {
        (_, false) => None,
        (Some(store), true) => {
            let options = texel_options(args, Some(store))?;
            Some((store, options))
        }
        (None, true) => {
            let message = "--mip fits levels to samples: name the sampled SBRDF (.zarr) before --merge";
            return Err(Error::input(message));
        }
    };
    if let (Some((_, options)), Some(shard)) = (&levels, args.merge.first()) {
        chunks::same_options(shard, options)?;
    }
    write_map(&map, output, args.encoding())?;
    if let Some((store, options)) = &levels {
        write_levels(store, options, (output, &map, args.encoding()), (&args.made, held.as_ref()))?;
    }
    let summary = Summary::new(&map);
    let mut outcome = Findings::of_map(&map, &summary);
    let held_out = match &store {
        Some(store) => held_out::judge(held.as_ref(), store, &map, &mut outcome)?,
        None => String::new(),
    };
    outcome.add_joined(store.as_ref(), &map)?;
    let (file, shards) = (output.display(), counted(args.merge.len() as u64, "shard", "shards"));
    let residuals = residuals(&summary);
    print(&format!("{file}: {} texels of {shards}\n{residuals}{held_out}", map.width * map.height))?;
    Ok(outcome)
}
