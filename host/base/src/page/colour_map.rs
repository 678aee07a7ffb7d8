//! Colour maps: viridis for magnitudes, blue–white–red for signed values.

/// A colour map by its equidistant stops, blended linearly.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ColourMap {
    /// Perceptually uniform, dark to bright.
    Viridis,
    /// Blue below the middle, white there, red above.
    Signed,
}

const VIRIDIS: [[u8; 3]; 11] = [
    [68, 1, 84],
    [72, 36, 117],
    [65, 68, 135],
    [53, 95, 141],
    [42, 120, 142],
    [33, 145, 140],
    [34, 168, 132],
    [68, 191, 112],
    [122, 209, 81],
    [189, 223, 38],
    [253, 231, 37],
];

const SIGNED: [[u8; 3]; 7] = [
    [33, 102, 172],
    [103, 169, 207],
    [209, 229, 240],
    [247, 247, 247],
    [253, 219, 199],
    [239, 138, 98],
    [178, 24, 43],
];

impl ColourMap {
    fn stops(self) -> &'static [[u8; 3]] {
        match self {
            Self::Viridis => &VIRIDIS,
            Self::Signed => &SIGNED,
        }
    }

    /// The colour at 0..1; values outside take the nearest end, NaN the first stop.
    pub fn at(self, t: f64) -> [u8; 3] {
        let stops = self.stops();
        let place = t.clamp(0.0, 1.0) * (stops.len() - 1) as f64;
        let below = (place as usize).min(stops.len() - 2);
        let part = if place.is_nan() { 0.0 } else { place - below as f64 };
        std::array::from_fn(|c| {
            let (from, to) = (f64::from(stops[below][c]), f64::from(stops[below + 1][c]));
            (from + part * (to - from)).round() as u8
        })
    }

    /// The map as a CSS gradient from left to right.
    pub fn css(self) -> String {
        let stops = self.stops().iter().map(|[r, g, b]| format!("#{r:02x}{g:02x}{b:02x}"));
        format!("linear-gradient(to right,{})", stops.collect::<Vec<_>>().join(","))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ends_are_the_maps_ends_and_values_outside_are_clamped() {
        for (map, first, last) in
            [(ColourMap::Viridis, VIRIDIS[0], VIRIDIS[10]), (ColourMap::Signed, SIGNED[0], SIGNED[6])]
        {
            assert_eq!([map.at(0.0), map.at(-3.0), map.at(f64::NAN)], [first; 3]);
            assert_eq!([map.at(1.0), map.at(9.0)], [last; 2]);
        }
        assert_eq!(ColourMap::Signed.at(0.5), [247; 3]);
    }

    #[test]
    fn viridis_grows_brighter_all_the_way() {
        let brightness = |t: f64| {
            let [r, g, b] = ColourMap::Viridis.at(t).map(f64::from);
            0.2126 * r + 0.7152 * g + 0.0722 * b
        };
        assert!((0..100).all(|k| brightness(f64::from(k + 1) / 100.0) > brightness(f64::from(k) / 100.0)));
    }
}
