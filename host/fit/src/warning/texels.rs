//! Texels of a fitted map that a person should look at: too few valid samples, and residuals that the noise
//! does not explain.

use crate::fit::FitOptions;
use crate::fit::pool::RegionReport;
use crate::fit::texel::{OVER_NOISE, unknowns};
use lobelia_base::warning::{Kind, NAMED, Warning, percent};
use lobelia_reflectance::SbrdfMap;

/// A residual is not explained when it is more than so many times its noise, and more than this share of the
/// samples' RMS: below that, registration, lamp and geometry, of which σ knows nothing, explain it.
const TIMES: f32 = 3.0;
const SHARE: f32 = 0.1;
/// From this share of the texels on that is a warning. Below, it may be edges of a pattern, where light of
/// two materials mixes: on the small samples of the simulated rig a fifth to two fifths of the texels.
const MOST_UNEXPLAINED: f64 = 0.5;
/// More than this share of the texels with too few samples is told.
const MOST_TEXELS: f64 = 0.1;

/// Edge of the blocks by which a place in the image is told.
const BLOCK: usize = 16;

/// The texels of a map with a residual that their noise does not explain; none where noise was not known.
pub fn unexplained(map: &SbrdfMap) -> Option<Vec<bool>> {
    let (over_noise, relative) = (map.extra.get(OVER_NOISE)?, map.extra.get("error.relative")?);
    Some(over_noise.iter().zip(relative).map(|(&times, &share)| times > TIMES && share > SHARE).collect())
}

/// How many texels noise does not explain, their share and where most of them are; none where there is no
/// such texel.
fn unexplained_texels(map: &SbrdfMap) -> Option<(usize, f64, String)> {
    let flags = unexplained(map)?;
    let count = flags.iter().filter(|&&flag| flag).count();
    let share = count as f64 / flags.len().max(1) as f64;
    (count > 0).then(|| {
        let text = format!(
            "{count} of {} texels ({}) have a residual that their noise does not explain, {}",
            flags.len(),
            percent(share),
            place(map, &flags)
        );
        (count, share, text)
    })
}

/// Warns where noise does not explain the residual of most texels.
pub fn unexplained_warning(map: &SbrdfMap) -> Option<Warning> {
    let (count, _, text) = unexplained_texels(map).filter(|(_, share, _)| *share >= MOST_UNEXPLAINED)?;
    let text = format!(
        "{text}: photographs that do not fit together, or a material that is no sum of so few lobes; see the \
         channel {OVER_NOISE}"
    );
    Some(Warning { texels: Some(count), ..Warning::new(Kind::UnexplainedTexels, text) })
}

/// A line about the texels that noise does not explain, where they are too few for a warning; empty where
/// there is none.
pub fn unexplained_in_words(map: &SbrdfMap) -> String {
    match unexplained_texels(map) {
        Some((_, share, text)) if share < MOST_UNEXPLAINED => {
            format!(
                "not explained: {text}; edges between materials, or too few lobes; see the channel \
                 {OVER_NOISE}\n"
            )
        }
        _ => String::new(),
    }
}

/// Warns where many texels have valid samples, but too few for the lobes that were asked for or may be
/// chosen.
pub fn few_samples(map: &SbrdfMap, options: &FitOptions) -> Option<Warning> {
    let needed = unknowns(options.lobes, options);
    let flags: Vec<bool> =
        map.extra.get("samples")?.iter().map(|&count| count > 0.0 && count as usize <= needed).collect();
    let count = flags.iter().filter(|&&flag| flag).count();
    if count as f64 <= MOST_TEXELS * flags.len() as f64 {
        return None;
    }
    let lobes = if options.lobes == 1 { "1 lobe".into() } else { format!("{} lobes", options.lobes) };
    let what = if options.choose {
        format!(
            "have {needed} valid samples or fewer, too few to try {lobes}: --lobes auto chose among fewer \
             there"
        )
    } else {
        format!("have no more valid samples than {lobes} have unknowns ({needed}) and got fewer lobes")
    };
    let text =
        format!("{count} of {} texels {what}, {}; see the channel samples", flags.len(), place(map, &flags));
    Some(Warning { texels: Some(count), ..Warning::new(Kind::FewPoses, text) })
}

/// Names the regions of a pooled fit of which no sample was fitted.
pub fn empty_regions(regions: &[RegionReport]) -> Option<Warning> {
    let empty: Vec<&RegionReport> = regions.iter().filter(|region| region.fitted == 0).collect();
    let list: Vec<String> = empty.iter().take(NAMED).map(|region| region.name.clone()).collect();
    let more = match empty.len().saturating_sub(NAMED) {
        0 => String::new(),
        more => format!(" and {more} more"),
    };
    let word = match empty.len() {
        0 => return None,
        1 => "region",
        _ => "regions",
    };
    let samples: usize = empty.iter().map(|region| region.samples).sum();
    let why = if samples == 0 {
        "no texel there has a valid sample".to_string()
    } else {
        format!("none of the {samples} valid samples there was fitted")
    };
    let text = format!("{word} {}{more}: {why}; the texels are black", list.join(", "));
    let texels = empty.iter().map(|region| region.texels).sum();
    Some(Warning { texels: Some(texels), ..Warning::new(Kind::EmptyRegion, text) })
}

/// Where in the image most of the marked texels lie.
fn place(map: &SbrdfMap, flags: &[bool]) -> String {
    let across = map.width.div_ceil(BLOCK);
    let mut counts = vec![0usize; across * map.height.div_ceil(BLOCK)];
    for (index, _) in flags.iter().enumerate().filter(|(_, flag)| **flag) {
        counts[index / map.width / BLOCK * across + index % map.width / BLOCK] += 1;
    }
    let densest = (0..counts.len()).rev().max_by_key(|&block| counts[block]).unwrap_or(0);
    let (left, top) = (densest % across.max(1) * BLOCK, densest / across.max(1) * BLOCK);
    let (right, bottom) = ((left + BLOCK).min(map.width) - 1, (top + BLOCK).min(map.height) - 1);
    format!("most in columns {left} to {right}, rows {top} to {bottom}")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 40 × 20 texels, those of the first `bad` columns with a residual of so many times the noise and this
    /// share of the samples.
    fn map(bad: usize, times: f32, share: f32) -> SbrdfMap {
        let mut map = SbrdfMap::new(40, 20, 1);
        let plane = |value: f32, else_value: f32| -> Vec<f32> {
            (0..800).map(|index| if index % 40 < bad { value } else { else_value }).collect()
        };
        map.extra.insert(OVER_NOISE.into(), plane(times, 1.0));
        map.extra.insert("error.relative".into(), plane(share, 0.02));
        map
    }

    #[test]
    fn many_texels_above_their_noise_are_told_with_number_and_place_and_few_are_not() {
        let found = unexplained_warning(&map(24, 8.0, 0.3)).unwrap();
        assert_eq!((found.kind, found.texels), (Kind::UnexplainedTexels, Some(480)));
        assert_eq!(unexplained_in_words(&map(24, 8.0, 0.3)), "");
        assert!(
            found.text.contains("480 of 800") && found.text.contains("columns 0 to 15, rows 0 to 15"),
            "{}",
            found.text
        );
        for quiet in [map(12, 8.0, 0.3), map(24, 2.0, 0.3), map(24, 8.0, 0.05), SbrdfMap::new(40, 20, 1)] {
            assert_eq!(unexplained_warning(&quiet), None);
        }
        let words = unexplained_in_words(&map(12, 8.0, 0.3));
        assert!(words.starts_with("not explained: 240 of 800 texels"), "{words}");
        assert_eq!(unexplained_in_words(&map(24, 2.0, 0.3)), "");
    }

    #[test]
    fn regions_without_a_fitted_sample_are_named_and_others_are_not() {
        let region = |number: usize, fitted: usize, samples: usize| RegionReport {
            name: format!("{number} #000000"),
            texels: 10,
            samples,
            fitted,
            lobes: 0,
            rms: 0.0,
            relative: 0.0,
            bounded: 0,
        };
        assert_eq!(empty_regions(&[region(1, 40, 400)]), None);
        let found = empty_regions(&[region(1, 40, 400), region(2, 0, 0), region(3, 0, 0)]).unwrap();
        assert_eq!((found.kind, found.texels), (Kind::EmptyRegion, Some(20)));
        assert!(found.text.starts_with("regions 2 #000000, 3 #000000: no texel there"), "{}", found.text);
        let found = empty_regions(&[region(1, 0, 12)]).unwrap();
        assert!(found.text.contains("none of the 12 valid samples"), "{}", found.text);
    }

    #[test]
    fn many_texels_with_no_more_samples_than_unknowns_are_told_and_few_or_those_without_any_are_not() {
        let two = FitOptions { lobes: 2, ..FitOptions::default() };
        let with = |columns: usize, count: f32, options: &FitOptions| {
            let mut map = SbrdfMap::new(20, 20, 2);
            let of = |index: usize| if index % 20 >= 20 - columns { count } else { 80.0 };
            map.extra.insert("samples".into(), (0..400).map(of).collect());
            few_samples(&map, options)
        };
        for (columns, count) in [(4, 80.0), (4, 8.0), (4, 0.0), (2, 7.0)] {
            assert_eq!(with(columns, count, &two), None, "{columns} {count}");
        }
        let found = with(4, 7.0, &two).unwrap();
        assert_eq!((found.kind, found.texels), (Kind::FewPoses, Some(80)));
        assert!(
            found.text.contains("2 lobes have unknowns (7) and got fewer lobes")
                && found.text.contains("columns 16 to 19"),
            "{}",
            found.text
        );
        let auto = FitOptions { lobes: 4, choose: true, ..two };
        let found = with(4, 13.0, &auto).unwrap();
        assert!(
            found.text.contains("have 13 valid samples or fewer, too few to try 4 lobes"),
            "{}",
            found.text
        );
    }
}
