// What a pixel sees of a texture; part of lights.wgsl. See render/lights/footprint.rs.

// What of the texture a pixel sees, in texels of the finest level: samples along one or two axes, on a level or between two.
struct Footprint {
    centre: vec2f,
    along: vec2f,
    across: vec2f,
    counts: vec2u,
    level: f32,
    // Texels that a sample takes: the four around it, or one of them where there are many samples.
    around: u32,
}

// Samples from which on one texel each is enough.
const MANY = 64u;

fn footprint_of(object: u32, uv: vec2f, dx: vec2f, dy: vec2f) -> Footprint {
    let size = vec2f(f32(materials[object].width), f32(materials[object].height));
    let scale = materials[object].tiling * size;
    let x = dx * scale;
    let y = dy * scale;
    let long_x = length(x);
    let long_y = length(y);
    var out = Footprint(fract(uv * materials[object].tiling) * size, x, y, vec2u(1u), 0.0, select(1u, 4u, materials[object].bilinear != 0u));
    let most = f32(ANISOTROPY);
    if SHADED {
        if materials[object].width * materials[object].height > 1u {
            out.counts = vec2u(clamp(ceil(vec2f(long_x, long_y)), vec2f(1.0), vec2f(most)));
            out.around = select(out.around, 1u, out.counts.x * out.counts.y >= MANY);
        }
    } else if materials[object].levels > 0u {
        let longer = max(long_x, long_y);
        let shorter = max(min(long_x, long_y), 1e-6);
        out.along = select(y, x, long_x >= long_y);
        let count = clamp(ceil(min(longer / shorter, longer)), 1.0, most);
        out.counts.x = u32(count);
        out.level = clamp(log2(max(longer / count, 1.0)), 0.0, f32(materials[object].levels));
    }
    return out;
}

struct Tap {
    texel: u32,
    weight: f32,
}

// Number of texels that a footprint takes.
fn tap_count(footprint: Footprint) -> u32 {
    let levels = select(1u, 2u, fract(footprint.level) > 0.0);
    return footprint.counts.x * footprint.counts.y * levels * footprint.around;
}

// The additive recurrence of the plane's plastic number, low in discrepancy (Roberts 2018).
const SPREAD = vec2f(0.7548777, 0.5698403);

fn tap(object: u32, footprint: Footprint, index: u32) -> Tap {
    var rest = index;
    var weight = 1.0;
    var neighbour = 0u;
    if footprint.around == 4u {
        neighbour = rest & 3u;
        rest >>= 2u;
    }
    var level = u32(footprint.level);
    let part = fract(footprint.level);
    if part > 0.0 {
        weight = select(1.0 - part, part, (rest & 1u) != 0u);
        level += rest & 1u;
        rest >>= 1u;
    }
    // Divisions in floats: those of integers are slow.
    let counts = vec2f(footprint.counts);
    let row = floor((f32(rest) + 0.5) / counts.x);
    let step = (vec2f(f32(rest) - row * counts.x, row) + 0.5) / counts - 0.5;
    weight /= counts.x * counts.y;

    var first = materials[object].first;
    var size = vec2u(materials[object].width, materials[object].height);
    let finest = size;
    for (var l = 0u; l < level; l++) {
        first += size.x * size.y;
        size = (finest + ((1u << (l + 1u)) - 1u)) >> vec2u(l + 1u);
    }
    let place = (footprint.centre + footprint.along * step.x + footprint.across * step.y) / f32(1u << level);
    var corner = floor(place);
    if SHADED && footprint.around == 1u && materials[object].bilinear != 0u {
        // Spread over a texel, samples weigh their neighbours as interpolation does in the mean.
        corner = floor(place + fract(SPREAD * f32(rest)) - 0.5);
    }
    if footprint.around == 4u {
        corner = floor(place - 0.5);
        let f = place - 0.5 - corner;
        let right = (neighbour & 1u) != 0u;
        let below = (neighbour & 2u) != 0u;
        weight *= select(1.0 - f.x, f.x, right) * select(1.0 - f.y, f.y, below);
        corner += vec2f(f32(neighbour & 1u), f32(neighbour >> 1u));
    }
    let wrapped = vec2u(corner - floor((corner + 0.5) / vec2f(size)) * vec2f(size));
    return Tap(first + wrapped.y * size.x + wrapped.x, weight);
}

// Radiance over a footprint.
fn by_footprint(object: u32, footprint: Footprint, lit: ptr<function, Lit>) -> vec3f {
    let brightest = materials[object].brightest;
    let count = tap_count(footprint);
    var radiance = vec3f(0.0);
    if !COEFFICIENTS {
        for (var k = 0u; k < count; k++) {
            let one = tap(object, footprint, k);
            if one.weight > 0.0 {
                radiance += one.weight * by_texel(object, one.texel, brightest, lit);
            }
        }
        return radiance;
    }
    // A lobe that one texel lacks has its shape from the others.
    for (var j = 0u; j == 0u || j < materials[object].lobes; j++) {
        var sum = Lobe(vec4f(0.0), vec2f(0.0), vec3f(0.0), 0.0, 0.0);
        var whole = 0.0;
        for (var k = 0u; k < count; k++) {
            let one = tap(object, footprint, k);
            let texel = texel_at(starts[one.texel], brightest);
            if j == 0u {
                let coats = by_coats(object, one.texel, brightest, lit);
                radiance += one.weight * (texel.rho_d * (*lit).sum + coats);
            }
            let at = starts[one.texel] + header_words() + 2u * GROUP * j;
            if one.weight > 0.0 && at < starts[one.texel + 1u] - coat_words(object) {
                let lobe = lobe_at(at, texel, brightest);
                sum.c += one.weight * lobe.c;
                sum.tilt += one.weight * lobe.tilt;
                sum.rho_s += one.weight * lobe.rho_s;
                sum.n += one.weight * lobe.n;
                sum.n_grazing += one.weight * lobe.n_grazing;
                whole += one.weight;
            }
        }
        if whole > 0.0 {
            let mean = Lobe(sum.c / whole, sum.tilt / whole, sum.rho_s, sum.n / whole, sum.n_grazing / whole);
            radiance += by_lobe(mean, lit);
        }
    }
    return radiance;
}
