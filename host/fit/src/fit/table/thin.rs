//! Rows to search with where a table has many: all of the brightest, where highlights are, and an even share
//! of the others, weighted to stand for all.

use super::super::samples::Samples;

/// Most rows that a search needs.
const MOST: usize = 3000;
/// Share of them that are the brightest rows.
const BRIGHT: f64 = 0.3;
/// The golden ratio's fraction: its multiples take rows evenly and in step with no grid.
const GOLDEN: f64 = 0.618_033_988_749_894_9;

/// The rows with factors for their weights, in their order; none where a search takes all.
pub(super) fn rows(samples: &Samples) -> Option<Vec<(usize, f64)>> {
    let count = samples.len();
    if count <= MOST {
        return None;
    }
    let mut by_brightness: Vec<usize> = (0..count).collect();
    let seen = |k: usize| samples.value[k] * samples.cos_o[k];
    by_brightness.sort_by(|&a, &b| seen(b).total_cmp(&seen(a)).then(a.cmp(&b)));
    let bright = (BRIGHT * MOST as f64) as usize;
    let mut is_bright = vec![false; count];
    by_brightness[..bright].iter().for_each(|&k| is_bright[k] = true);
    let share = (MOST - bright) as f64 / (count - bright) as f64;
    let taken = |k: usize| is_bright[k] || (k as f64 * GOLDEN).fract() < share;
    let factor = |k: usize| if is_bright[k] { 1.0 } else { 1.0 / share };
    Some((0..count).filter(|&k| taken(k)).map(|k| (k, factor(k))).collect())
}

#[cfg(test)]
mod tests {
    use super::super::super::testing;
    use super::*;
    use lobelia_reflectance::{Brdf, Rgb, materials};

    #[test]
    fn the_thinned_rows_stand_for_all_and_have_the_brightest() {
        let clay = materials::published("clay").unwrap();
        let few = testing::samples(&testing::directions(500, 2), |wi, wo| clay.eval(wi, wo));
        assert!(rows(&few).is_none());
        let many = testing::samples(&testing::directions(20_000, 2), |wi, wo| clay.eval(wi, wo));
        let part = rows(&many).unwrap();
        assert!(part.len() > 2800 && part.len() < 3200, "{}", part.len());
        let whole: f64 = part.iter().map(|&(_, factor)| factor).sum();
        assert!((whole / 20_000.0 - 1.0).abs() < 0.02, "{whole}");
        let brightest = (0..many.len()).max_by(|&a, &b| many.value[a].total_cmp(&many.value[b])).unwrap();
        assert!(part.iter().any(|&(k, factor)| k == brightest && factor == 1.0));
        let sum = |value: &dyn Fn(usize) -> f64| part.iter().map(|&(k, f)| f * value(k)).sum::<f64>();
        let all: f64 = many.value.iter().sum();
        assert!((sum(&|k| many.value[k]) / all - 1.0).abs() < 0.02);
        assert_eq!(testing::samples(&[], |_, _| Rgb::ZERO).part(&[]).len(), 0);
    }
}
