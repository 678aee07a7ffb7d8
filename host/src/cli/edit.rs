//! `lobelia edit`: what can be done to SBRDF maps without measuring anew.

use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};

use super::{Context, map_encoding};
use crate::edit::pairs::Pairs;
use crate::edit::picture::{Mask, Photo};
use crate::edit::{self, cluster, composite, diffuse, palette, photo, tile};
use crate::error::{Error, Result};
use crate::figures::ErrorFigure;
use crate::files;
use crate::fit::MOST_LOBES;
use crate::progress::counted;
use crate::reflectance::{LobeBrdf, MapEncoding, SbrdfMap};

/// Arguments of `lobelia edit`.
#[derive(Debug, Args)]
pub(super) struct EditArgs {
    #[command(subcommand)]
    edit: Edit,
    /// Writes the map in lines deflated by ZIP, which every program that reads OpenEXR opens, instead of in
    /// tiles, which are faster
    #[arg(long, global = true)]
    scanlines: bool,
}

/// What can be done.
#[derive(Debug, Subcommand)]
enum Edit {
    /// Reduces a map to a palette of BRDFs and an index image, both to be edited; `edit palette` makes a map
    /// of them again
    Cluster(ClusterArgs),
    /// Makes a map of a palette and an index image
    Palette(PaletteArgs),
    /// Takes the mean BRDF of a map, or of a mask's texels, as a map of one texel
    Mean(MeanArgs),
    /// Lays one map over another where a mask is white; grey blends them by reflectance
    Composite(CompositeArgs),
    /// Takes the diffuse channel from a photograph, with the map's mean diffuse reflectance kept
    ReplaceDiffuse(ReplaceArgs),
    /// Makes a map of one photograph, with one lobe over it; the defaults are for varnished cherry wood
    FromPhoto(PhotoArgs),
    /// Makes a map tileable: cuts a seam where its opposite borders, laid over each other, differ least
    Tile(TileArgs),
}

#[derive(Debug, Args)]
struct ClusterArgs {
    /// The map (OpenEXR)
    map: PathBuf,
    /// BRDFs of the palette, 1 to 256
    #[arg(long, short = 'k', default_value_t = 16, value_name = "K")]
    count: usize,
    /// Where the palette goes: BRDFs as text
    #[arg(long, short, value_name = "PALETTE.toml")]
    output: PathBuf,
    /// Where the index image goes, each BRDF in a colour of its own
    #[arg(long, value_name = "INDEX.png")]
    index: PathBuf,
}

#[derive(Debug, Args)]
struct PaletteArgs {
    /// The palette, as `edit cluster` writes it
    palette: PathBuf,
    /// The index image: every pixel has the colour of a swatch
    #[arg(long, value_name = "INDEX.png")]
    index: PathBuf,
    /// The map to write
    #[arg(long, short, value_name = "FILE.exr")]
    output: PathBuf,
}

#[derive(Debug, Args)]
struct MeanArgs {
    /// The map (OpenEXR)
    map: PathBuf,
    /// Grey picture of the map's size: the share with which each texel counts, white in full; all alike when
    /// not given
    #[arg(long, value_name = "MASK.png")]
    mask: Option<PathBuf>,
    /// Lobes of the mean; as many as the map has when not given
    #[arg(long, value_name = "N")]
    lobes: Option<usize>,
    /// The map of one texel to write
    #[arg(long, short, value_name = "FILE.exr")]
    output: PathBuf,
}

#[derive(Debug, Args)]
struct CompositeArgs {
    /// The map that shows where the mask is black
    base: PathBuf,
    /// The map of the same size that shows where the mask is white
    over: PathBuf,
    /// Grey picture of the maps' size
    #[arg(long, value_name = "MASK.png")]
    mask: PathBuf,
    /// The map to write
    #[arg(long, short, value_name = "FILE.exr")]
    output: PathBuf,
}

#[derive(Debug, Args)]
struct ReplaceArgs {
    /// The map (OpenEXR)
    map: PathBuf,
    /// PNG or JPEG (sRGB), OpenEXR or Radiance HDR (linear); as large as the map, or a whole number of times
    /// as large in both directions
    #[arg(long, value_name = "PHOTO")]
    photo: PathBuf,
    /// The map to write, of the photograph's size
    #[arg(long, short, value_name = "FILE.exr")]
    output: PathBuf,
}

#[derive(Debug, Args)]
struct PhotoArgs {
    /// PNG or JPEG (sRGB), OpenEXR or Radiance HDR (linear)
    photo: PathBuf,
    /// The map to write
    #[arg(long, short, value_name = "FILE.exr")]
    output: PathBuf,
    /// Mean exponent of the lobe
    #[arg(long, default_value_t = photo::Recipe::default().n)]
    n: f64,
    /// Standard deviation of the exponent from texel to texel
    #[arg(long, default_value_t = photo::Recipe::default().n_sigma)]
    n_sigma: f64,
    /// Exponent in the darkest pixels, the grain
    #[arg(long, default_value_t = photo::Recipe::default().n_dark)]
    n_dark: f64,
    /// How many of the pixels count as darkest, percent
    #[arg(long, default_value_t = photo::Recipe::default().dark_percent)]
    dark_percent: f64,
    /// Cx = Cy of the lobe
    #[arg(long, default_value_t = photo::Recipe::default().c[0], allow_negative_numbers = true)]
    cx: f64,
    /// Cz of the lobe
    #[arg(long, default_value_t = photo::Recipe::default().c[1], allow_negative_numbers = true)]
    cz: f64,
    /// Strength of the lobe: 1 is as bright as white paper where the lobe's base is 1
    #[arg(long, default_value_t = photo::Recipe::default().specular)]
    specular: f64,
}

#[derive(Debug, Args)]
struct TileArgs {
    /// The map (OpenEXR)
    map: PathBuf,
    /// Texels by which the borders overlap; the result is so much smaller. An eighth of the map when not
    /// given
    #[arg(long, value_name = "TEXELS")]
    overlap: Option<usize>,
    /// The map to write
    #[arg(long, short, value_name = "FILE.exr")]
    output: PathBuf,
}

/// Runs `lobelia edit`.
pub(super) fn run(args: &EditArgs, context: &mut Context) -> Result<()> {
    let encoding = map_encoding(args.scanlines);
    match &args.edit {
        Edit::Cluster(_) if args.scanlines => {
            Err(Error::input("--scanlines is for edits that write a map; cluster writes a palette"))
        }
        Edit::Cluster(args) => run_cluster(args, context),
        Edit::Palette(args) => run_palette(args, encoding, context),
        Edit::Mean(args) => run_mean(args, encoding, context),
        Edit::Composite(args) => run_composite(args, encoding, context),
        Edit::ReplaceDiffuse(args) => run_replace(args, encoding, context),
        Edit::FromPhoto(args) => run_photo(args, encoding, context),
        Edit::Tile(args) => run_tile(args, encoding, context),
    }
}

/// Reads a map and notes it as an input.
fn read_map(path: &Path, context: &mut Context) -> Result<SbrdfMap> {
    context.report.input(path);
    let map = SbrdfMap::read_exr(path).map_err(|error| match error {
        crate::reflectance::FormatError::Io(error) => Error::reading(path, error),
        invalid => Error::input(invalid.to_string()),
    })?;
    if !map.microfacets.is_empty() {
        let message = format!("{}: the map has a microfacet term, which `edit` cannot blend", path.display());
        return Err(Error::input(message));
    }
    if let Some(what) = map.extension() {
        return Err(Error::input(format!(
            "{}: the map has {what}, which `edit` cannot blend",
            path.display()
        )));
    }
    Ok(map)
}

fn read_mask(path: &Path, context: &mut Context) -> Result<Mask> {
    context.report.input(path);
    Mask::read(path)
}

fn read_photo(path: &Path, context: &mut Context) -> Result<Photo> {
    context.report.input(path);
    Photo::read(path)
}

/// Refuses an output whose name does not say what it is, or that cannot be written, before any work.
fn ends_in(path: &Path, extension: &str) -> Result<()> {
    if files::ending(path) == extension {
        return files::try_file(path);
    }
    Err(Error::input(format!("{}: the name must end in .{extension}", path.display())))
}

/// The last part of a path, for provenance: a map may be moved to where its sources' folders mean nothing.
fn name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// Notes the edit with the hashes of its inputs, writes the map and says so.
fn finish(
    mut map: SbrdfMap,
    what: &str,
    (output, encoding): (&Path, MapEncoding),
    context: &Context,
) -> Result<()> {
    let inputs = context.report.inputs.iter().map(|input| {
        let sha256 = input.sha256.as_deref().unwrap_or("unknown");
        format!("{} sha256 {sha256}", name(Path::new(&input.path)))
    });
    edit::note(&mut map, format!("{what}; {}", inputs.collect::<Vec<_>>().join(", ")));
    // What made the map before is in its notes; a date of it would be taken for this one's.
    map.attributes.retain(|name, _| !name.starts_with("made."));
    map.attributes.extend(context.report.provenance());
    map.write_exr_as(output, encoding).map_err(|error| Error::writing(output, error))?;
    let lobes = counted(map.lobes.len() as u64, "lobe", "lobes");
    println!("{}: {} × {} texels, {lobes}", output.display(), map.width, map.height);
    Ok(())
}

fn run_cluster(args: &ClusterArgs, context: &mut Context) -> Result<()> {
    ends_in(&args.output, "toml")?;
    ends_in(&args.index, "png")?;
    let map = read_map(&args.map, context)?;
    let seed = context.seed;
    let clusters = context.report.stage("cluster", || cluster::cluster(&map, args.count, seed))?;
    computed(&map, &args.map, clusters.relative + clusters.relative_of_texels)?;
    let whole = clusters.index.len() as f64;
    let share = |&count: &usize| {
        format!("{}, {:.1} %", counted(count as u64, "texel", "texels"), 100.0 * count as f64 / whole)
    };
    let notes: Vec<String> = clusters.count.iter().map(share).collect();
    let entries = palette::with_swatches(clusters.palette);
    files::write_bytes(&args.output, palette::to_toml(&entries, &notes).as_bytes())?;
    let alpha = map.extra.get(edit::ALPHA).map(Vec::as_slice);
    palette::write_index_cut(&args.index, (map.width, map.height), &clusters.index, alpha, &entries)?;
    for (name, error) in [
        ("palette_relative_l2", clusters.relative),
        ("palette_of_texels_relative_l2", clusters.relative_of_texels),
    ] {
        let figure = ErrorFigure::new(name, error, "1", format!("{whole} texels"));
        context.report.errors.push(figure.with("brdfs", entries.len()));
    }
    println!(
        "{}: {}; {}: {} × {} texels; reflectance off by {:.2} %, by the nearest texels in their place {:.2} \
         % (relative L2, weighted by cosθ_i cosθ_o)",
        args.output.display(),
        counted(entries.len() as u64, "BRDF", "BRDFs"),
        args.index.display(),
        map.width,
        map.height,
        100.0 * clusters.relative,
        100.0 * clusters.relative_of_texels
    );
    Ok(())
}

fn run_palette(args: &PaletteArgs, encoding: MapEncoding, context: &mut Context) -> Result<()> {
    ends_in(&args.output, "exr")?;
    context.report.input(&args.palette);
    context.report.input(&args.index);
    let entries = palette::read(&args.palette)?;
    let map = palette::apply(&args.index, &entries)?;
    finish(
        map,
        &format!("palette of {}", counted(entries.len() as u64, "BRDF", "BRDFs")),
        (&args.output, encoding),
        context,
    )
}

fn run_mean(args: &MeanArgs, encoding: MapEncoding, context: &mut Context) -> Result<()> {
    ends_in(&args.output, "exr")?;
    let map = read_map(&args.map, context)?;
    let mask = args.mask.as_deref().map(|path| read_mask(path, context)).transpose()?;
    if let (Some(mask), Some(path)) = (&mask, &args.mask) {
        sizes([&args.map, path], &map, (mask.width, mask.height))?;
    }
    let lobes = args.lobes.unwrap_or(map.lobes.len());
    if lobes > MOST_LOBES && lobes > map.lobes.len() {
        return Err(Error::input(format!(
            "{lobes} lobes were asked for; at most {MOST_LOBES} can be fitted"
        )));
    }
    let mean = context.report.stage("mean", || composite::mean(&map, mask.as_ref(), lobes))?;
    computed(&map, &args.map, mean.relative)?;
    let over = format!("{} pairs of directions", edit::blend::PAIRS);
    context
        .report
        .errors
        .push(ErrorFigure::new("blend_relative_l2", mean.relative, "1", over).with("lobes", lobes));
    println!("the fit leaves {:.2} % of the mean reflectance (relative L2)", 100.0 * mean.relative);
    finish(
        SbrdfMap::from_texels(1, 1, &[mean.brdf]),
        "mean by reflectance",
        (&args.output, encoding),
        context,
    )
}

/// Refuses a map whose coefficients are numbers, but not such as can be computed with: what became of them is
/// not.
fn computed(map: &SbrdfMap, path: &Path, result: f64) -> Result<()> {
    if result.is_finite() {
        return Ok(());
    }
    let place = absurd_texel(map).map_or_else(String::new, |k| {
        format!("; look at the coefficients of texel ({}, {})", k % map.width, k / map.width)
    });
    let message = "its reflectance is too large to compute with";
    Err(Error::input(format!("{}: {message}{place}", path.display())))
}

/// The first texel whose reflectance has no square in single precision.
fn absurd_texel(map: &SbrdfMap) -> Option<usize> {
    let pairs = Pairs::over(std::iter::empty::<&LobeBrdf>(), edit::blend::PAIRS);
    let absurd = |k: &usize| {
        let albedo = pairs.albedo(&map.texel(*k));
        !albedo.is_finite() || albedo.abs().max_element() > f32::MAX.sqrt() / 1e3
    };
    (0..map.width * map.height).find(absurd)
}

/// Refuses a picture or a map of another size than the first map's.
fn sizes(paths: [&Path; 2], map: &SbrdfMap, other: (usize, usize)) -> Result<()> {
    let names = paths.map(|path| path.display().to_string());
    edit::same_size([&names[0], &names[1]], (map.width, map.height), other)
}

fn run_composite(args: &CompositeArgs, encoding: MapEncoding, context: &mut Context) -> Result<()> {
    ends_in(&args.output, "exr")?;
    let (base, over) = (read_map(&args.base, context)?, read_map(&args.over, context)?);
    let mask = read_mask(&args.mask, context)?;
    sizes([&args.base, &args.over], &base, (over.width, over.height))?;
    sizes([&args.base, &args.mask], &base, (mask.width, mask.height))?;
    let (map, worst) = context.report.stage("composite", || composite::composite(&base, &over, &mask));
    if !worst.is_finite() {
        let of_base = absurd_texel(&base).is_some();
        let (map, path) = if of_base { (&base, &args.base) } else { (&over, &args.over) };
        computed(map, path, worst)?;
    }
    let over = format!("worst of {} texels", mask.share.len());
    context.report.errors.push(ErrorFigure::new("blend_relative_l2", worst, "1", over));
    finish(map, "composite by a mask", (&args.output, encoding), context)
}

fn run_replace(args: &ReplaceArgs, encoding: MapEncoding, context: &mut Context) -> Result<()> {
    ends_in(&args.output, "exr")?;
    let map = read_map(&args.map, context)?;
    let photo = read_photo(&args.photo, context)?;
    let replaced = diffuse::replace(&map, &photo).map_err(|error| error.at(args.photo.display()))?;
    tell_too_bright(&replaced, &args.photo, "much brighter than in mean", context);
    finish(replaced, "diffuse channel by a photograph, mean kept", (&args.output, encoding), context)
}

/// Tells how many texels of a map reflect more light than they receive by what a photograph says, and where
/// it says so.
fn tell_too_bright(map: &SbrdfMap, photo: &Path, bright: &str, context: &mut Context) {
    let (count, most) = diffuse::too_bright(map);
    context.report.figure("texels_too_bright", count);
    if count > 0 {
        let texels = counted(count as u64, "texel", "texels");
        context.note(format!(
            "{}: {texels} would reflect up to {most:.2} times the light that they receive, where the \
             photograph is {bright}; take its highlights out",
            photo.display()
        ));
    }
}

fn run_photo(args: &PhotoArgs, encoding: MapEncoding, context: &mut Context) -> Result<()> {
    ends_in(&args.output, "exr")?;
    let recipe = photo::Recipe {
        n: args.n,
        n_sigma: args.n_sigma,
        n_dark: args.n_dark,
        dark_percent: args.dark_percent,
        c: [args.cx, args.cz],
        specular: args.specular,
    };
    recipe.check()?;
    let picture = read_photo(&args.photo, context)?;
    let map =
        photo::from_photo(&picture, &recipe, context.seed).map_err(|error| error.at(args.photo.display()))?;
    tell_too_bright(&map, &args.photo, "brighter than white paper", context);
    finish(
        map,
        &format!("from a photograph, {recipe:?}, seed {}", context.seed),
        (&args.output, encoding),
        context,
    )
}

fn run_tile(args: &TileArgs, encoding: MapEncoding, context: &mut Context) -> Result<()> {
    ends_in(&args.output, "exr")?;
    let map = read_map(&args.map, context)?;
    let overlap = args.overlap.unwrap_or_else(|| (map.width.min(map.height) / 8).max(1));
    let tile = context.report.stage("tile", || tile::tile(&map, overlap))?;
    let [overlapping, seam] = tile.mismatch;
    for (value, place) in [(overlapping, "overlap"), (seam, "seam")] {
        let over = "texels, over the mean difference between neighbours of the map";
        context.report.errors.push(ErrorFigure::new("mismatch", value, "1", over).with("place", place));
    }
    println!(
        "borders differ by {overlapping:.2} of the step between neighbours all over, by {seam:.2} along the \
         seams"
    );
    finish(
        tile.map,
        &format!("tileable by a seam in an overlap of {}", counted(overlap as u64, "texel", "texels")),
        (&args.output, encoding),
        context,
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reflectance::materials;
    use crate::report::Report;
    use clap::Parser;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        args: EditArgs,
    }

    /// A folder with a map `a.exr` of 8 × 6 texels, one `small.exr` of 1 × 1, a photograph and a mask of the
    /// map's size.
    fn folder() -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        let texels = ["clay", "felt"].map(|name| materials::published(name).unwrap());
        let map: Vec<_> = (0..48).map(|k| texels[k / 4 % 2].clone()).collect();
        SbrdfMap::from_texels(8, 6, &map).write_exr(&folder.path().join("a.exr")).unwrap();
        SbrdfMap::from_texels(1, 1, &texels[..1]).write_exr(&folder.path().join("small.exr")).unwrap();
        let grey = |x: u32| image::Rgb([if x < 4 { 0 } else { 255 }; 3]);
        image::RgbImage::from_fn(8, 6, |x, _| grey(x)).save(folder.path().join("mask.png")).unwrap();
        folder
    }

    /// Runs a line in which words with a dot are files of the folder.
    fn edit(folder: &Path, line: &str) -> Result<Report> {
        let place = |word: &str| {
            let file = word.contains('.') && !word.starts_with('-');
            if file { folder.join(word).display().to_string() } else { word.to_string() }
        };
        let words = std::iter::once("edit".to_string()).chain(line.split(' ').map(place));
        let mut context = Context {
            seed: 1,
            given_seed: None,
            quiet: true,
            verbose: false,
            report: Report::new("edit", 1),
        };
        run(&Line::try_parse_from(words).unwrap().args, &mut context).map(|()| context.report)
    }

    #[test]
    fn a_map_goes_through_a_palette_and_comes_back_as_it_was() {
        let folder = folder();
        let path = folder.path();
        let report = edit(path, "cluster a.exr -k 2 -o p.toml --index i.png").unwrap();
        assert!(report.errors[0].value < 1e-6);
        edit(path, "palette p.toml --index i.png -o b.exr").unwrap();
        let [a, b] = ["a.exr", "b.exr"].map(|name| SbrdfMap::read_exr(&path.join(name)).unwrap());
        for k in 0..48 {
            assert_eq!(a.texel(k), b.texel(k));
        }
        assert!(b.attributes["edit.1"].contains("palette of 2 BRDFs; p.toml sha256 "), "{:?}", b.attributes);
    }

    /// OpenEXR's compression, by its header: 3 is ZIP of 16 lines; a version with bit 9 has tiles.
    #[test]
    fn lines_are_written_where_they_are_asked_for() {
        let folder = folder();
        let of = |line: &str| {
            edit(folder.path(), line).unwrap();
            let bytes = std::fs::read(folder.path().join("o.exr")).unwrap();
            let key = b"compression\0compression\0";
            let place = bytes.windows(key.len()).position(|part| part == key).unwrap();
            (bytes[5] & 2 != 0, bytes[place + key.len() + 4])
        };
        let (tiles, _) = of("tile a.exr --overlap 2 -o o.exr");
        assert!(tiles);
        assert_eq!(of("tile a.exr --overlap 2 -o o.exr --scanlines"), (false, 3));
        assert!(edit(folder.path(), "cluster a.exr -o p.toml --index i.png --scanlines").is_err());
    }

    #[test]
    fn every_edit_writes_a_map_that_says_what_was_done() {
        let folder = folder();
        let path = folder.path();
        for (line, size, note) in [
            ("mean a.exr --mask mask.png -o o.exr", (1, 1), "mean by reflectance; a.exr"),
            ("composite a.exr a.exr --mask mask.png -o o.exr", (8, 6), "composite by a mask"),
            ("replace-diffuse a.exr --photo mask.png -o o.exr", (8, 6), "mean kept; a.exr sha256"),
            ("from-photo mask.png -o o.exr --n 30", (8, 6), "n: 30.0"),
            ("tile a.exr --overlap 2 -o o.exr", (6, 4), "an overlap of 2 texels"),
        ] {
            edit(path, line).unwrap();
            let map = SbrdfMap::read_exr(&path.join("o.exr")).unwrap();
            assert_eq!((map.width, map.height), size, "{line}");
            assert!(map.attributes["edit.1"].contains(note), "{line}: {:?}", map.attributes);
        }
    }

    /// Of a perfect diffuser's radiance 900 times in one pixel, as in a photograph with a lamp in it.
    #[test]
    fn a_photograph_s_highlight_that_makes_a_texel_brighter_than_its_light_is_told() {
        let folder = folder();
        let mut pixels = vec![glam::Vec4::new(0.5, 0.5, 0.5, 1.0); 200];
        pixels[7].x = 900.0;
        let lamp = crate::render::Picture { width: 20, height: 10, pixels };
        lamp.write(&folder.path().join("lamp.exr"), 1.0).unwrap();
        let told = |line: &str| edit(folder.path(), line).unwrap().figures["texels_too_bright"].clone();
        assert_eq!(told("from-photo lamp.exr -o o.exr"), 1);
        assert_eq!(told("from-photo mask.png -o o.exr"), 0);
    }

    /// Finite, but its square is not in single precision.
    #[test]
    fn a_coefficient_that_nothing_can_be_computed_with_is_told_by_its_texel_and_nothing_is_written() {
        let folder = folder();
        let path = folder.path();
        let mut map = SbrdfMap::read_exr(&path.join("a.exr")).unwrap();
        map.rho_d[11] = crate::reflectance::Rgb::splat(1e30);
        map.write_exr(&path.join("b.exr")).unwrap();
        for line in ["mean b.exr --lobes 1 -o o.exr", "cluster b.exr -k 2 -o o.toml --index o.png"] {
            let error = edit(path, line).unwrap_err();
            let named = error.to_string().contains("b.exr: its reflectance is too large");
            assert!(named && error.to_string().contains("texel (3, 1)"), "{line}: {error}");
            assert!(error.exit_code() == 2 && !path.join("o.exr").exists() && !path.join("o.toml").exists());
        }
    }

    #[test]
    fn inputs_that_do_not_fit_end_with_a_sentence_that_names_them() {
        let folder = folder();
        for run in ["r.exr", "r.png"] {
            crate::files::write_bytes(&folder.path().join(run).join("journal.jsonl"), b"").unwrap();
        }
        for (line, part) in [
            ("mean small.exr --mask mask.png -o o.exr", "mask.png has 8 × 6"),
            ("composite a.exr small.exr --mask mask.png -o o.exr", "small.exr has 1 × 1"),
            ("composite small.exr small.exr --mask mask.png -o o.exr", "mask.png has 8 × 6"),
            ("tile small.exr -o o.exr", "overlap of 1 texel was"),
            ("tile a.exr -o o.png", "must end in .exr"),
            ("mean none.exr -o o.exr", "none.exr: cannot be read"),
            (
                "mean mask.png -o o.exr",
                "mask.png: not a readable OpenEXR file: it does not begin as one does",
            ),
            ("mean r.exr -o o.exr", "r.exr: a run, no OpenEXR file"),
            ("replace-diffuse a.exr --photo r.png -o o.exr", "r.png: a run, where a file is needed"),
            ("mean a.exr --lobes 99 -o o.exr", "99 lobes"),
        ] {
            let error = edit(folder.path(), line).unwrap_err();
            assert!(error.exit_code() == 2 && error.to_string().contains(part), "{line}: {error}");
            assert!(!folder.path().join("o.exr").exists());
        }
    }
}
