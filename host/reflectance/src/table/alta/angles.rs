//! What the input columns of ALTA's format are, and the directions of light and view that they stand for.

use std::f64::consts::{FRAC_PI_2, PI};

use glam::DVec3;

use crate::table::half_angles;
use crate::table::parse::ANGLE_SLACK;

/// A parametrisation by its name in `#PARAM_IN`. Angles are in radians; l is the light, v the view, h the
/// half vector, d the difference.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Angles {
    /// θ_l, θ_v cosΔφ, θ_v sinΔφ, with the light at azimuth 0.
    Projected,
    /// θ_l, φ_l, θ_v, φ_v.
    Spherical,
    /// θ_v, θ_l, Δφ, with the view at azimuth 0: at Δφ = 0 light and view are on one side.
    ViewFirst,
    /// θ_h, φ_h, θ_d, φ_d.
    Half,
    /// θ_h, θ_d, φ_d.
    IsotropicHalf,
    /// θ_h, θ_d, at φ_d = 90°.
    HalfDifference,
    /// cosθ_h, cosθ_d, at φ_d = 0.
    Cosines,
    /// cosθ_h, at θ_d = 0: light and view along the half vector.
    CosineHalf,
    /// The unit vectors toward the view and toward the light.
    Cartesian,
}

/// All of them by name, with the number of their columns.
const ALL: [(&str, usize, Angles); 9] = [
    ("ISOTROPIC_TL_TV_PROJ_DPHI", 3, Angles::Projected),
    ("SPHERICAL_TL_PL_TV_PV", 4, Angles::Spherical),
    ("ISOTROPIC_TV_TL_DPHI", 3, Angles::ViewFirst),
    ("RUSIN_TH_PH_TD_PD", 4, Angles::Half),
    ("RUSIN_TH_TD_PD", 3, Angles::IsotropicHalf),
    ("RUSIN_TH_TD", 2, Angles::HalfDifference),
    ("COS_TH_TD", 2, Angles::Cosines),
    ("COS_TH", 1, Angles::CosineHalf),
    ("CARTESIAN", 6, Angles::Cartesian),
];

/// The parametrisation of a name, and the number of its columns.
pub(super) fn find(name: &str) -> Option<(Angles, usize)> {
    ALL.iter().find(|known| known.0 == name).map(|&(_, columns, angles)| (angles, columns))
}

/// The names that are known, as a list.
pub(super) fn names() -> String {
    ALL.map(|known| known.0).join(", ")
}

impl Angles {
    /// Unit vectors toward the light and toward the view for a row's input columns; none where one is below
    /// the surface.
    ///
    /// # Errors
    /// A sentence for an angle that no direction above the surface has.
    pub(super) fn directions(self, columns: &[f64]) -> Result<Option<[DVec3; 2]>, String> {
        let pair = match self {
            Self::Projected => {
                let view = direction("view", columns[1].hypot(columns[2]), columns[2].atan2(columns[1]))?;
                [direction("light", columns[0], 0.0)?, view]
            }
            Self::Spherical => {
                [direction("light", columns[0], columns[1])?, direction("view", columns[2], columns[3])?]
            }
            Self::ViewFirst => {
                [direction("light", columns[1], columns[2])?, direction("view", columns[0], 0.0)?]
            }
            Self::Half => half_angles(columns[0], columns[1], columns[2], columns[3]),
            Self::IsotropicHalf => half_angles(columns[0], 0.0, columns[1], columns[2]),
            Self::HalfDifference => half_angles(columns[0], 0.0, columns[1], FRAC_PI_2),
            Self::Cosines => half_angles(angle_of(columns[0])?, 0.0, angle_of(columns[1])?, 0.0),
            Self::CosineHalf => half_angles(angle_of(columns[0])?, 0.0, 0.0, 0.0),
            Self::Cartesian => {
                let [view, light] = [0, 3].map(|k| DVec3::from_slice(&columns[k..]));
                if [view, light].iter().any(|d| (d.length() - 1.0).abs() > 1e-3) {
                    return Err("a direction's three numbers are not those of a unit vector".into());
                }
                [light.normalize(), view.normalize()]
            }
        };
        // At the horizon rounding must not decide.
        let above = pair.iter().all(|d| d.z > -ANGLE_SLACK);
        Ok(above.then_some(pair))
    }
}

/// The direction of a polar angle, which may be negative, and an azimuth.
fn direction(what: &str, theta: f64, phi: f64) -> Result<DVec3, String> {
    if theta.abs() > FRAC_PI_2 + ANGLE_SLACK {
        return Err(format!("the {what}'s angle is {theta} rad; it must lie in 0 to {FRAC_PI_2:.4} rad"));
    }
    let (theta, phi) = if theta < 0.0 { (-theta, phi + PI) } else { (theta, phi) };
    Ok(crate::table::direction(theta.min(FRAC_PI_2), phi))
}

/// The angle of a cosine.
fn angle_of(cosine: f64) -> Result<f64, String> {
    if cosine.abs() > 1.0 + 1e-6 {
        return Err(format!("{cosine} is no cosine of an angle"));
    }
    Ok(cosine.clamp(-1.0, 1.0).acos())
}
