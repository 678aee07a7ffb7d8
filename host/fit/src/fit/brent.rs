//! Minima of functions of one variable: a bracket, looked for downhill from a start or all over a range, and
//! Brent's method within it.

/// Growth of the steps of the downhill search.
const GROWTH: f64 = 1.618_033_988_749_895;
/// Share of the longer side at which golden section cuts.
const GOLDEN: f64 = 0.381_966_011_250_105;
/// Most steps of Brent's method.
const STEPS: usize = 80;

/// Three places of which the middle one is nowhere above the others; at an end of the range two of them are
/// the same.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Bracket {
    /// Left place.
    pub low: f64,
    /// Place of the least value.
    pub middle: f64,
    /// Right place.
    pub high: f64,
    /// The value at the middle one.
    pub value: f64,
}

/// A bracket in the valley into which a first step from `start` leads: downhill with growing steps until the
/// function rises again or the range ends.
pub(crate) fn downhill(
    mut f: impl FnMut(f64) -> f64,
    start: f64,
    step: f64,
    [least, most]: [f64; 2],
) -> Bracket {
    let (mut behind, mut at) = (start, start + step);
    let (first, mut value) = (f(behind), f(at));
    let mut stride = step;
    if value > first {
        (behind, at, value, stride) = (at, behind, first, -step);
    }
    loop {
        stride *= GROWTH;
        let ahead = (at + stride).clamp(least, most);
        let next = if ahead == at { value } else { f(ahead) };
        if ahead == at || next >= value {
            return Bracket { low: behind.min(ahead), middle: at, high: behind.max(ahead), value };
        }
        (behind, at, value) = (at, ahead, next);
    }
}

/// The bracket of the least of `count` + 1 evenly spaced values over a range.
pub(crate) fn over(f: impl FnMut(f64) -> f64, [least, most]: [f64; 2], count: usize) -> Bracket {
    let place = |index: usize| least + (most - least) * index as f64 / count as f64;
    let values: Vec<f64> = (0..=count).map(place).map(f).collect();
    let best = (0..=count).min_by(|&a, &b| values[a].total_cmp(&values[b])).unwrap_or(0);
    Bracket {
        low: place(best.saturating_sub(1)),
        middle: place(best),
        high: place((best + 1).min(count)),
        value: values[best],
    }
}

/// The place of the least value within a bracket to about `width`: parabolas, golden section where they fail.
pub(crate) fn minimise(mut f: impl FnMut(f64) -> f64, bracket: Bracket, width: f64) -> f64 {
    let Bracket { low: mut a, middle: mut x, high: mut b, value: mut fx } = bracket;
    let (mut w, mut v) = (x, x);
    let (mut fw, mut fv) = (fx, fx);
    let (mut d, mut e) = (0.0f64, 0.0f64);
    for _ in 0..STEPS {
        let middle = 0.5 * (a + b);
        if (x - middle).abs() <= 2.0 * width - 0.5 * (b - a) {
            break;
        }
        let r = (x - w) * (fx - fv);
        let q = (x - v) * (fx - fw);
        let p = (x - v) * q - (x - w) * r;
        let q = 2.0 * (q - r);
        let (p, q) = if q > 0.0 { (-p, q) } else { (p, -q) };
        if e.abs() > width && p.abs() < (0.5 * q * e).abs() && p > q * (a - x) && p < q * (b - x) {
            e = d;
            d = p / q;
        } else {
            e = if x < middle { b - x } else { a - x };
            d = GOLDEN * e;
        }
        let u = if d.abs() >= width { x + d } else { x + width.copysign(d) };
        let fu = f(u);
        if fu <= fx {
            if u < x {
                b = x
            } else {
                a = x
            }
            (v, fv, w, fw, x, fx) = (w, fw, x, fx, u, fu);
        } else {
            if u < x {
                a = u
            } else {
                b = u
            }
            if fu <= fw || w == x {
                (v, fv, w, fw) = (w, fw, u, fu);
            } else if fu <= fv || v == x || v == w {
                (v, fv) = (u, fu);
            }
        }
    }
    x
}

#[cfg(test)]
mod tests {
    use super::*;

    const RANGE: [f64; 2] = [-1.0, 8.0];

    /// Two valleys, the deeper one at 6.
    fn valleys(x: f64) -> f64 {
        ((x - 1.0).powi(2)).min((x - 6.0).powi(2) - 1.0)
    }

    #[test]
    fn brent_finds_the_minimum_of_a_skewed_valley_from_either_bracket() {
        let f = |x: f64| (x - 1.234f64).powi(2) * (2.0 + x);
        for bracket in [over(f, RANGE, 12), downhill(f, 5.0, 0.1, RANGE), downhill(f, 0.0, 0.1, RANGE)] {
            let x = minimise(f, bracket, 1e-5);
            assert!((x - 1.234).abs() < 1e-4, "{bracket:?} {x}");
        }
    }

    #[test]
    fn the_downhill_search_stays_in_its_valley_and_the_other_finds_the_deepest() {
        let near = minimise(valleys, downhill(valleys, 2.0, 0.1, RANGE), 1e-5);
        let deepest = minimise(valleys, over(valleys, RANGE, 12), 1e-5);
        assert!((near - 1.0).abs() < 1e-3 && (deepest - 6.0).abs() < 1e-3, "{near} {deepest}");
    }

    #[test]
    fn a_function_that_falls_to_the_end_of_the_range_ends_there() {
        for (slope, end) in [(1.0, RANGE[0]), (-1.0, RANGE[1])] {
            let f = |x: f64| slope * x;
            let x = minimise(f, downhill(f, 2.0, 0.1, RANGE), 1e-5);
            assert!((x - end).abs() < 1e-3, "{slope} {x}");
        }
    }
}
