use super::*;

/// A picture whose pixel (x, y) is 1 + x + 4 y in red, by a line of its size and pixels in the order of the
/// file.
fn flat(header: &str, size: &str, order: &[usize]) -> Vec<u8> {
    let mut bytes = format!("#?RGBE\n{header}\n{size}\n").into_bytes();
    bytes.extend(order.iter().flat_map(|&k| [1 + k as u8, 0, 0, 136]));
    bytes
}

fn reds(bytes: &[u8]) -> (usize, usize, Vec<f32>) {
    let Radiance { width, height, pixels } = parse(bytes).unwrap();
    (width, height, pixels.iter().map(|pixel| pixel.x).collect())
}

#[test]
fn every_order_of_pixels_gives_the_picture_upright() {
    let upright = (3, 2, vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
    for (size, order) in [
        ("-Y 2 +X 3", [0, 1, 2, 3, 4, 5]),
        ("+Y 2 +X 3", [3, 4, 5, 0, 1, 2]),
        ("-Y 2 -X 3", [2, 1, 0, 5, 4, 3]),
        ("+Y 2 -X 3", [5, 4, 3, 2, 1, 0]),
        ("+X 3 -Y 2", [0, 3, 1, 4, 2, 5]),
        ("-X 3 +Y 2", [5, 2, 4, 1, 3, 0]),
    ] {
        assert_eq!(reds(&flat("", size, &order)), upright, "{size}");
    }
}

#[test]
fn lines_that_end_as_windows_ends_them_are_read() {
    let mut bytes = b"#?RADIANCE\r\nFORMAT=32-bit_rle_rgbe\r\n\r\n-Y 1 +X 1\r\n".to_vec();
    bytes.extend([128, 64, 0, 129]);
    assert_eq!(parse(&bytes).unwrap().pixels, [Rgb::new(1.0, 0.5, 0.0)]);
}

#[test]
fn exposures_and_colour_corrections_are_divided_out_and_primaries_converted() {
    let plain = parse(&flat("", "-Y 1 +X 2", &[0, 1])).unwrap().pixels;
    let scaled = parse(&flat("EXPOSURE=4\nEXPOSURE= 0.5\nCOLORCORR=5 1 1\n", "-Y 1 +X 2", &[0, 1])).unwrap();
    for (scaled, plain) in scaled.pixels.iter().zip(&plain) {
        assert!((scaled.x * 10.0 - plain.x).abs() < 1e-5, "{scaled} {plain}");
    }
    // Grey stays grey under other primaries of the same white, red does not stay red.
    let mut bytes =
        b"#?RADIANCE\nPRIMARIES=.7347 .2653 .1152 .8264 .1566 .0177 .3127 .3290\n\n-Y 1 +X 2\n".to_vec();
    bytes.extend([128, 128, 128, 129, 128, 0, 0, 129]);
    let pixels = parse(&bytes).unwrap().pixels;
    assert!((pixels[0] - Rgb::ONE).abs().max_element() < 1e-3 && pixels[1].x > 1.2, "{pixels:?}");
}

#[test]
fn the_shipped_cases_agree_whatever_their_exposure_and_encoding() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/cases/hdr");
    let [plain, exposure, flat] =
        ["plain", "exposure", "flat"].map(|name| read(&folder.join(format!("{name}.hdr"))).unwrap());
    assert_eq!((plain.width, plain.height), (32, 16));
    assert_eq!((flat.width, flat.height), (32, 16));
    // A step of the mantissa is 2⁻⁸ of the largest component.
    for (bright, plain) in exposure.pixels.iter().zip(&plain.pixels) {
        assert!((*bright - *plain).abs().max_element() <= plain.max_element() / 100.0, "{bright} {plain}");
    }
    assert!(flat.pixels.iter().all(|pixel| pixel.min_element() > 0.0));
}

#[test]
fn old_run_lengths_repeat_the_pixel_before() {
    let mut bytes = b"#?RADIANCE\n\n-Y 1 +X 7\n".to_vec();
    bytes.extend([1, 2, 3, 136, 1, 1, 1, 5, 9, 0, 0, 136]);
    assert_eq!(reds(&bytes), (7, 1, vec![1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 9.0]));
}

#[test]
fn what_is_no_picture_or_too_large_or_cut_short_is_refused() {
    let cut = flat("", "-Y 2 +X 3", &[0, 1, 2, 3, 4]);
    for (bytes, part) in [
        (&b"P6 3 2"[..], "begins with #?RADIANCE"),
        (b"#?RADIANCE\nFORMAT=32-bit_rle_xyze\n\n-Y 1 +X 1\n", "32-bit_rle_xyze"),
        (b"#?RADIANCE\nEXPOSURE=0\n\n-Y 1 +X 1\n", "EXPOSURE=0"),
        (b"#?RADIANCE\n", "ends in its header"),
        (b"#?RADIANCE\n\n-Y 1 -Y 1\n", "-Y 1 -Y 1"),
        (b"#?RADIANCE\n\n-Y 100000 +X 100000\nabcd", "cannot hold 100000 × 100000"),
        (&cut, "scanline 1 of 2"),
    ] {
        let text = parse(bytes).err().unwrap();
        assert!(text.contains(part), "{text}");
    }
}
