//! Fresnel's equations for unpolarised light at smooth interfaces: dielectrics, with total reflection, and
//! conductors.

use glam::Vec3;

use crate::Rgb;

/// Reflectance of a smooth dielectric and the cosine of the refracted direction, 0 in total reflection;
/// `cosine` is that of the angle of incidence, `ratio` the index of refraction beyond over that on the side
/// of incidence.
pub fn dielectric(cosine: f32, ratio: f32) -> (f32, f32) {
    let cosine = cosine.clamp(0.0, 1.0);
    let square = 1.0 - (1.0 - cosine * cosine) / (ratio * ratio);
    if square <= 0.0 {
        return (1.0, 0.0);
    }
    let beyond = square.sqrt();
    let s = (cosine - ratio * beyond) / (cosine + ratio * beyond);
    let p = (beyond - ratio * cosine) / (beyond + ratio * cosine);
    // Equal indices at grazing incidence leave 0 over 0, and nothing is reflected.
    let reflectance = 0.5 * (s * s + p * p);
    (if reflectance.is_nan() { 0.0 } else { reflectance }, beyond)
}

/// The direction into which `wo` is refracted, both in the frame of a surface with z on the side of `wo`,
/// away from the point.
pub fn refracted(wo: Vec3, ratio: f32, cosine_beyond: f32) -> Vec3 {
    Vec3::new(-wo.x / ratio, -wo.y / ratio, -cosine_beyond)
}

/// Reflectance of a smooth conductor of index `n` + i `k`, each channel of its own, both over the index on
/// the side of incidence.
pub fn conductor(cosine: f32, n: Rgb, k: Rgb) -> Rgb {
    let cosine = cosine.clamp(0.0, 1.0);
    let channel = |n: f32, k: f32| {
        let (cos2, sin2) = (cosine * cosine, 1.0 - cosine * cosine);
        let t = n * n - k * k - sin2;
        // a² + b², and a of √((n + i k)² − sin²θ) = a + i b.
        let length2 = (t * t + 4.0 * n * n * k * k).sqrt();
        let a = (0.5 * (length2 + t)).max(0.0).sqrt();
        let s = (length2 + cos2 - 2.0 * a * cosine) / (length2 + cos2 + 2.0 * a * cosine);
        let product = cos2 * length2 + sin2 * sin2;
        let twice = 2.0 * a * cosine * sin2;
        let p = s * (product - twice) / (product + twice);
        let reflectance = 0.5 * (s + p);
        if reflectance.is_nan() { 1.0 } else { reflectance }
    };
    Rgb::new(channel(n.x, k.x), channel(n.y, k.y), channel(n.z, k.z))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn at_normal_incidence_it_is_the_square_of_the_difference_over_the_sum() {
        for ratio in [1.0, 1.33, 1.5, 2.4, 1.0 / 1.5] {
            let expected = ((ratio - 1.0f32) / (ratio + 1.0)).powi(2);
            assert!((dielectric(1.0, ratio).0 - expected).abs() < 1e-6, "{ratio}");
        }
        let (n, k) = (0.2f32, 3.9f32);
        let expected = ((n - 1.0).powi(2) + k * k) / ((n + 1.0).powi(2) + k * k);
        assert!((conductor(1.0, Rgb::splat(n), Rgb::splat(k)).x - expected).abs() < 1e-6);
    }

    #[test]
    fn at_brewsters_angle_only_one_polarisation_is_reflected() {
        let n = 1.5f32;
        let cosine = 1.0 / (1.0 + n * n).sqrt();
        let expected = 0.5 * ((n * n - 1.0) / (n * n + 1.0)).powi(2);
        assert!((dielectric(cosine, n).0 - expected).abs() < 1e-6);
    }

    #[test]
    fn beyond_the_critical_angle_all_is_reflected_and_the_way_back_reflects_as_much() {
        let n = 1.5f32;
        let critical = (1.0 - 1.0 / (n * n)).sqrt();
        assert_eq!(dielectric(critical - 1e-3, 1.0 / n), (1.0, 0.0));
        assert!(dielectric(critical + 1e-3, 1.0 / n).0 < 1.0);
        for degrees in [0.0f32, 20.0, 50.0, 80.0, 89.0] {
            let (there, beyond) = dielectric(degrees.to_radians().cos(), n);
            let (back, cosine) = dielectric(beyond, 1.0 / n);
            assert!((there - back).abs() < 1e-4 && (cosine - degrees.to_radians().cos()).abs() < 1e-5);
        }
    }

    #[test]
    fn the_refracted_direction_obeys_snell_and_stays_in_the_plane() {
        let wo = Vec3::new(0.5, -0.3, 0.7).normalize();
        let (_, beyond) = dielectric(wo.z, 1.4);
        let wt = refracted(wo, 1.4, beyond);
        assert!((wt.length() - 1.0).abs() < 1e-6 && wt.z < 0.0);
        let sine = |v: Vec3| v.truncate().length();
        assert!(
            (sine(wo) - 1.4 * sine(wt)).abs() < 1e-6 && wo.truncate().perp_dot(wt.truncate()).abs() < 1e-6
        );
    }

    #[test]
    fn a_conductor_that_does_not_absorb_is_a_dielectric() {
        for degrees in [0.0f32, 30.0, 60.0, 85.0, 90.0] {
            let cosine = degrees.to_radians().cos();
            let metal = conductor(cosine, Rgb::splat(1.6), Rgb::ZERO).x;
            assert!((metal - dielectric(cosine, 1.6).0).abs() < 1e-5, "{degrees}");
        }
        // Complex arithmetic of another form: gold's red at 60°.
        let (n, k, cosine) = (0.143f64, 3.983f64, 0.5f64);
        let (re, im) = (n * n - k * k - 0.75, 2.0 * n * k);
        let (length, angle) = (re.hypot(im).sqrt(), im.atan2(re) / 2.0);
        let (a, b) = (length * angle.cos(), length * angle.sin());
        let s = ((cosine - a).powi(2) + b * b) / ((cosine + a).powi(2) + b * b);
        let (er, ei) = (n * n - k * k, 2.0 * n * k);
        let below = [er * cosine - a, ei * cosine - b];
        let above = [er * cosine + a, ei * cosine + b];
        let square = |[x, y]: [f64; 2]| x * x + y * y;
        let expected = 0.5 * (s + square(below) / square(above));
        let got = conductor(0.5, Rgb::splat(0.143), Rgb::splat(3.983)).x;
        assert!((f64::from(got) - expected).abs() < 1e-5, "{got} {expected}");
    }
}
