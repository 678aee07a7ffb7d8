//! What `lobelia fit` says of a map, line by line.

use crate::findings::Summary;
use crate::fit::FitOptions;
use crate::reflectance::SbrdfMap;

/// `2 lobes`, or how many texels took how many.
pub(super) fn lobes(map: &SbrdfMap, options: &FitOptions) -> String {
    let word = |count: usize| if count == 1 { "lobe" } else { "lobes" };
    let Some(chosen) = map.extra.get("lobes") else {
        return format!("{} {}", options.lobes, word(options.lobes));
    };
    let most = map.lobes.len();
    let share = |count: usize| {
        let texels = chosen.iter().filter(|&&lobes| lobes as usize == count).count();
        100.0 * texels as f64 / chosen.len().max(1) as f64
    };
    let shares: Vec<String> =
        (0..=most).map(|count| format!("{count} {} in {:.0} %", word(count), share(count))).collect();
    let doubtful =
        map.extra.get("lobes.doubtful").map_or(0, |plane| plane.iter().filter(|&&x| x > 0.0).count());
    match doubtful {
        0 => shares.join(", "),
        count => format!(
            "{} (told apart from another number by little in {:.0} %)",
            shares.join(", "),
            100.0 * count as f64 / chosen.len().max(1) as f64
        ),
    }
}

/// The residuals.
pub(super) fn residuals(of: &Summary) -> String {
    let [median, p95] = of.residual.map(|value| 100.0 * value);
    format!("residual: median {median:.2} % of the samples' RMS, 95 % of the texels below {p95:.2} %\n")
}

/// How many texels have a mirror; empty where none has.
pub(super) fn mirrors(of: &Summary) -> String {
    match of.mirrors {
        0 => String::new(),
        count => format!(
            "mirror: {count} of {} texels have a peak that the poses do not resolve; left out of the lobes, \
             in mirror.*\n",
            of.texels
        ),
    }
}

/// How many texels have coefficients that a prior decided; empty where none has.
pub(super) fn ties(of: &Summary) -> String {
    match of.tied {
        0 => String::new(),
        count => format!(
            "tied: {count} of {} texels have coefficients that the poses do not tell, taken from neighbours \
             or Phong's lobe\n",
            of.texels
        ),
    }
}

/// How many texels make no light only because they are held to that, and at what price; of a free fit how
/// many make light.
pub(super) fn albedos(of: &Summary) -> String {
    let [median, most] = of.price().map(|price| 100.0 * price);
    match (&of.bound_prices, of.making_light) {
        (Some(prices), _) if prices.is_empty() => String::new(),
        (Some(prices), _) => format!(
            "bounded: {} of {} texels would, where no pose looked, reflect more light than they receive or \
             far more than was measured; holding them costs {median:.2} % of the samples' RMS in median, \
             {most:.2} % at most\n",
            prices.len(),
            of.texels
        ),
        (None, (0, _)) => String::new(),
        (None, (count, largest)) => format!(
            "not to be trusted: {count} of {} texels reflect more light than they receive, up to \
             {largest:.3} times; leave out --no-bound\n",
            of.texels
        ),
    }
}
