//! Real spherical harmonics Y_lm, index i = l(l + 1) + m, of degree 0 to [`MOST`], with the phase (−1)^m of
//! (2.9):
//!
//! Y_lm = √2 K cos(mφ) P_l^m (m > 0), √2 K sin(|m|φ) P_l^|m| (m < 0), K P_l^0, K² = (2l + 1)(l − |m|)! /
//! 4π(l + |m|)!
//!
//! P_l^m = Q_l^m(z) sin^m θ, and sin^m θ cos mφ, sin mφ are the real and the imaginary part of (x + iy)^m:
//! polynomials without a singular pole, and dQ_l^m/dz = −Q_l^(m+1).

use std::f64::consts::PI;
use std::sync::OnceLock;

use glam::{DQuat, DVec3};

/// The highest degree.
pub(super) const MOST: usize = 8;
/// Coefficients to that degree.
pub(super) const COUNT: usize = count(MOST);
/// Nodes at most that [`gauss`] has.
pub(super) const MOST_NODES: usize = 24;

/// Coefficients to a degree.
pub(super) const fn count(degree: usize) -> usize {
    (degree + 1) * (degree + 1)
}

/// √2 K, or K, at i(l, m) for m ≥ 0.
fn norms() -> &'static [f64; COUNT] {
    static NORMS: OnceLock<[f64; COUNT]> = OnceLock::new();
    NORMS.get_or_init(|| {
        let mut norms = [0.0; COUNT];
        for l in 0..=MOST {
            for m in 0..=l {
                let product = (l - m + 1..=l + m).map(|k| k as f64).product::<f64>();
                let both = if m > 0 { 2.0 } else { 1.0 };
                norms[l * (l + 1) + m] = (both * (2 * l + 1) as f64 / (4.0 * PI * product)).sqrt();
            }
        }
        norms
    })
}

/// Q_l^m(z) at i(l, m), m ≥ 0, by (2.9) to (2.11); one degree of m more is 0.
fn legendre(degree: usize, z: f64) -> [f64; COUNT] {
    let mut q = [0.0; COUNT];
    let at = |l: usize, m: usize| l * (l + 1) + m;
    let mut diagonal = 1.0;
    for m in 0..=degree {
        q[at(m, m)] = diagonal;
        for l in m + 1..=degree {
            let before = if l > m + 1 { q[at(l - 2, m)] } else { 0.0 };
            q[at(l, m)] =
                ((2 * l - 1) as f64 * z * q[at(l - 1, m)] - (l + m - 1) as f64 * before) / (l - m) as f64;
        }
        diagonal *= -((2 * m + 1) as f64);
    }
    q
}

/// All Y_i to a degree in a unit direction; what is beyond is 0.
pub(super) fn basis(degree: usize, direction: DVec3) -> [f64; COUNT] {
    let (q, norms) = (legendre(degree, direction.z), norms());
    let mut y = [0.0; COUNT];
    let (mut re, mut im) = (1.0, 0.0);
    for m in 0..=degree {
        for l in m..=degree {
            let middle = l * (l + 1);
            let part = norms[middle + m] * q[middle + m];
            y[middle - m] = part * im;
            y[middle + m] = part * re;
        }
        (re, im) = (re * direction.x - im * direction.y, re * direction.y + im * direction.x);
    }
    y
}

/// The same with their slopes along two directions that are tangent to the sphere there.
pub(super) fn basis_with_slopes(
    degree: usize,
    direction: DVec3,
    along: [DVec3; 2],
) -> ([f64; COUNT], [[f64; COUNT]; 2]) {
    let (q, norms) = (legendre(degree, direction.z), norms());
    let (mut y, mut slopes) = ([0.0; COUNT], [[0.0; COUNT]; 2]);
    // (x + iy)^m, and the power before.
    let (mut power, mut before) = ([1.0, 0.0], [0.0; 2]);
    for m in 0..=degree {
        // Slopes of the power: m (x + iy)^(m − 1) times those of x + iy.
        let turning = along.map(|to| {
            [before[0] * to.x - before[1] * to.y, before[0] * to.y + before[1] * to.x]
                .map(|part| m as f64 * part)
        });
        for l in m..=degree {
            let middle = l * (l + 1);
            let norm = norms[middle + m];
            let value = norm * q[middle + m];
            let steep = if m < l { -norm * q[middle + m + 1] } else { 0.0 };
            y[middle - m] = value * power[1];
            y[middle + m] = value * power[0];
            for ((slopes, to), turning) in slopes.iter_mut().zip(along).zip(turning) {
                slopes[middle - m] = value * turning[1] + steep * to.z * power[1];
                slopes[middle + m] = value * turning[0] + steep * to.z * power[0];
            }
        }
        let [re, im] = power;
        before = power;
        power = [re * direction.x - im * direction.y, re * direction.y + im * direction.x];
    }
    (y, slopes)
}

/// Coefficients of the clamped cosine about a unit normal.
pub(super) fn cosine(degree: usize, normal: DVec3) -> [f64; COUNT] {
    let mut coefficients = basis(degree, normal);
    for l in 0..=degree {
        let zonal = clamped(l);
        coefficients[l * l..count(l)].iter_mut().for_each(|value| *value *= zonal);
    }
    coefficients
}

/// 2π ∫ z P_l(z) dz over 0..1: what a band of the clamped cosine is to that of its axis.
fn clamped(l: usize) -> f64 {
    match l {
        0 => PI,
        1 => 2.0 * PI / 3.0,
        _ if l % 2 == 1 => 0.0,
        _ => {
            // (−1)^(l/2 − 1) / ((l + 2)(l − 1)) · l! / (2^l (l/2)!²)
            let half = l / 2;
            let central: f64 = (1..=half).map(|k| (half + k) as f64 / (4 * k) as f64).product();
            let sign = if half % 2 == 1 { 1.0 } else { -1.0 };
            2.0 * PI * sign * central / ((l + 2) * (l - 1)) as f64
        }
    }
}

/// Coefficients of a function turned by a rotation: f(R⁻¹ω). The product of two functions of a degree is
/// integrated exactly by nodes of Gauss and Legendre in z and even ones about it.
pub(super) fn rotated(degree: usize, coefficients: &[[f64; COUNT]; 3], rotation: DQuat) -> [[f64; COUNT]; 3] {
    let mut turned = [[0.0; COUNT]; 3];
    let back = rotation.inverse();
    let around = 2 * degree + 1;
    for &[z, weight] in gauss(degree + 1) {
        let flat = (1.0 - z * z).sqrt();
        for k in 0..around {
            let (sin, cos) = (2.0 * PI * k as f64 / around as f64).sin_cos();
            let direction = DVec3::new(flat * cos, flat * sin, z);
            let from = basis(degree, back * direction);
            let to = basis(degree, direction);
            for (turned, given) in turned.iter_mut().zip(coefficients) {
                let value: f64 = given.iter().zip(from).map(|(c, y)| c * y).sum();
                let part = value * weight * 2.0 * PI / around as f64;
                turned.iter_mut().zip(to).for_each(|(turned, y)| *turned += part * y);
            }
        }
    }
    turned
}

/// Nodes over −1..1 and weights of Gauss and Legendre's quadrature, 1 to [`MOST_NODES`] of them.
pub(super) fn gauss(nodes: usize) -> &'static [[f64; 2]] {
    static RULES: OnceLock<Vec<Vec<[f64; 2]>>> = OnceLock::new();
    let rule = |n: usize| {
        (0..n).map(move |k| {
            let mut x = (PI * (k as f64 + 0.75) / (n as f64 + 0.5)).cos();
            let mut slope = 1.0;
            // Newton's steps double the digits.
            for _ in 0..8 {
                let (mut p, mut before) = (1.0, 0.0);
                for l in 1..=n {
                    let next = ((2 * l - 1) as f64 * x * p - (l - 1) as f64 * before) / l as f64;
                    (before, p) = (p, next);
                }
                slope = n as f64 * (x * p - before) / (x * x - 1.0);
                x -= p / slope;
            }
            [x, 2.0 / ((1.0 - x * x) * slope * slope)]
        })
    };
    let rules = RULES.get_or_init(|| (0..=MOST_NODES).map(|n| rule(n).collect()).collect());
    &rules[nodes.clamp(1, MOST_NODES)]
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// Directions all over the sphere with equal weights.
    pub(in super::super) fn spread(count: usize) -> impl Iterator<Item = DVec3> {
        (0..count).map(move |k| {
            let z = 1.0 - (2 * k + 1) as f64 / count as f64;
            let (sin, cos) = (k as f64 * 2.399_963_229_728_653).sin_cos();
            let flat = (1.0 - z * z).sqrt();
            DVec3::new(flat * cos, flat * sin, z)
        })
    }

    #[test]
    fn the_first_harmonics_are_the_closed_forms_of_tables() {
        for d in spread(50) {
            let y = basis(MOST, d);
            let DVec3 { x, y: v, z } = d;
            let (one, two, three) = ((3.0 / (4.0 * PI)).sqrt(), (15.0 / PI).sqrt(), (105.0 / PI).sqrt());
            let expected = [
                (0, (1.0 / (4.0 * PI)).sqrt()),
                (1, -one * v),
                (2, one * z),
                (3, -one * x),
                (4, two / 2.0 * x * v),
                (5, -two / 2.0 * v * z),
                (6, (5.0 / PI).sqrt() / 4.0 * (3.0 * z * z - 1.0)),
                (7, -two / 2.0 * x * z),
                (8, two / 4.0 * (x * x - v * v)),
                (10, three / 2.0 * x * v * z),
                (12, (7.0 / PI).sqrt() / 4.0 * z * (5.0 * z * z - 3.0)),
                (15, -(35.0 / (2.0 * PI)).sqrt() / 4.0 * x * (x * x - 3.0 * v * v)),
            ];
            for (index, value) in expected {
                assert!((y[index] - value).abs() < 1e-13, "Y {index}: {} for {value}", y[index]);
            }
        }
    }

    /// Σ_m Y_lm(a) Y_lm(b) = (2l + 1) P_l(a·b) / 4π.
    #[test]
    fn every_degree_obeys_the_addition_theorem() {
        for (a, b) in spread(30).zip(spread(31)) {
            let (ya, yb, p) = (basis(MOST, a), basis(MOST, b), legendre(MOST, a.dot(b)));
            for l in 0..=MOST {
                let sum: f64 = (l * l..count(l)).map(|i| ya[i] * yb[i]).sum();
                let expected = (2 * l + 1) as f64 * p[l * (l + 1)] / (4.0 * PI);
                assert!((sum - expected).abs() < 1e-12, "{l}: {sum} for {expected}");
            }
        }
    }

    #[test]
    fn slopes_are_those_of_differences() {
        for d in spread(20) {
            let aside = d.any_orthonormal_vector();
            let along = [aside, d.cross(aside)];
            let (y, slopes) = basis_with_slopes(MOST, d, along);
            assert_eq!(y, basis(MOST, d));
            for (slopes, along) in slopes.iter().zip(along) {
                let step = 1e-5;
                let [up, down] = [step, -step].map(|s| basis(MOST, (d + along * s).normalize()));
                for i in 0..COUNT {
                    let expected = (up[i] - down[i]) / (2.0 * step);
                    assert!((slopes[i] - expected).abs() < 1e-7, "Y {i} at {d}");
                }
            }
        }
    }

    #[test]
    fn a_turned_function_has_the_value_at_the_turned_direction() {
        let mut given = [[0.0; COUNT]; 3];
        for (k, value) in given.iter_mut().flatten().enumerate() {
            *value = (k as f64 * 0.7).sin();
        }
        let rotation = DQuat::from_euler(glam::EulerRot::XYZ, 0.4, -1.1, 2.3);
        let turned = rotated(MOST, &given, rotation);
        for d in spread(20) {
            let (from, to) = (basis(MOST, d), basis(MOST, rotation * d));
            for (given, turned) in given.iter().zip(&turned) {
                let value =
                    |c: &[f64; COUNT], y: &[f64; COUNT]| -> f64 { c.iter().zip(y).map(|(a, b)| a * b).sum() };
                assert!((value(given, &from) - value(turned, &to)).abs() < 1e-11);
            }
        }
        // Which keeps the norm.
        let norm = |c: &[[f64; COUNT]; 3]| c.iter().flatten().map(|v| v * v).sum::<f64>();
        assert!((norm(&given) / norm(&turned) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn the_cosine_lobe_is_the_projection_of_the_clamped_cosine() {
        let normal = DVec3::new(0.3, -0.5, 0.4).normalize();
        let mut expected = [0.0; COUNT];
        let directions = 400_000;
        for d in spread(directions) {
            let part = normal.dot(d).max(0.0) * 4.0 * PI / directions as f64;
            expected.iter_mut().zip(basis(MOST, d)).for_each(|(sum, y)| *sum += part * y);
        }
        let cosine = cosine(MOST, normal);
        for i in 0..COUNT {
            assert!((cosine[i] - expected[i]).abs() < 2e-5, "{i}: {} for {}", cosine[i], expected[i]);
        }
        // The digest's figure for a cut at l ≤ 4, 6, 8 of the whole energy 2π/3: 4.4, 2.8, 1.9 %.
        for (degree, part) in [(4, 0.044), (6, 0.028), (8, 0.019)] {
            let kept: f64 = cosine[..count(degree)].iter().map(|v| v * v).sum();
            let cut = (1.0 - kept / (2.0 * PI / 3.0)).max(0.0).sqrt();
            assert!((cut - part).abs() < 6e-4, "{degree}: {cut}");
        }
    }
}
