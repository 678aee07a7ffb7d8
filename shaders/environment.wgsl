// Light from afar by prefiltered maps (6.13)-(6.18), appended to lights.wgsl, which calls `distant_of`.
// The twin in Rust is host/render/src/render/environment/mod.rs, Light::reflected.

struct Sky {
    // Cosine and sine of the environment's turn about +y; maps of S; 1 to correct lobes near the horizon.
    turn: vec2f,
    maps: u32,
    horizon: u32,
    // 1 when D(N) comes from the nine coefficients of irradiance instead of its map.
    harmonics: u32,
    coefficients: array<vec4f, 9>,
}

struct Map {
    n: f32,
    first: u32,
    width: u32,
    height: u32,
}

@group(1) @binding(0) var<uniform> sky: Sky;
// D(N), then S by rising exponent.
@group(1) @binding(1) var<storage, read> maps: array<Map>;
// Roots of light, S^(1/n). The first and the last row of a map are the poles.
@group(1) @binding(2) var<storage, read> pixels: array<vec4f>;
// Factor, turn and sharpness of clipped lobes, by cosine (rows) and exponent; see render/environment/horizon.rs.
@group(1) @binding(3) var<storage, read> clipped: array<vec4f>;

// Microfacet terms by cosine of the exitant direction (rows) and root of alpha, two vectors each: albedo by f0 and by f90, the first
// lobe's share; angle and log2 n of both lobes. See render/environment/coats.rs.
@group(1) @binding(4) var<storage, read> coats: array<vec4f>;

const PI = 3.14159265;
const TAU = 6.28318531;
const COSINES = 97u;
const EXPONENTS = 29u;
const LOG2_LOW = -2.0;
const LOG2_STEP = 0.5;
const COATS = 33u;

// A world direction in the image's frame.
fn into_image(world: vec3f) -> vec3f {
    let c = sky.turn.x;
    let s = sky.turn.y;
    return vec3f(c * world.x - s * world.z, world.y, s * world.x + c * world.z);
}

// log2 S of a map at texture coordinates.
fn look_up(map: Map, uv: vec2f) -> vec3f {
    let x = uv.x * f32(map.width) - 0.5;
    let y = clamp(uv.y * f32(map.height - 1u), 0.0, f32(map.height - 1u));
    let low = vec2f(floor(x), floor(y));
    let f = vec2f(x, y) - low;
    let left = u32(i32(low.x) + i32(map.width)) % map.width;
    let right = (left + 1u) % map.width;
    let top = map.first + u32(low.y) * map.width;
    let bottom = map.first + min(u32(low.y) + 1u, map.height - 1u) * map.width;
    let above = mix(pixels[top + left].rgb, pixels[top + right].rgb, f.x);
    let below = mix(pixels[bottom + left].rgb, pixels[bottom + right].rgb, f.x);
    return max(map.n * log2(max(mix(above, below, f.y), vec3f(1e-37))), vec3f(-100.0));
}

fn texture_of(direction: vec3f) -> vec2f {
    return vec2f(0.5 + atan2(direction.x, -direction.z) / TAU, acos(clamp(direction.y, -1.0, 1.0)) / PI);
}

// S for a unit direction of the world and an exponent of the range; see prefilter.rs, Prefiltered::lobe.
fn lobe_light(peak: vec3f, n: f32) -> vec3f {
    let uv = texture_of(into_image(peak));
    let last = sky.maps;
    if last < 3u {
        return exp2(look_up(maps[1], uv));
    }
    var above = 2u;
    while above < last && maps[above].n < n {
        above++;
    }
    var first = above - 1u;
    if n * n < maps[above - 1u].n * maps[above].n {
        first = max(first, 2u) - 1u;
    }
    first = min(first, last - 2u);
    let a = maps[first + 1u].n - maps[first].n;
    let b = maps[first + 2u].n - maps[first].n;
    let x = n - maps[first].n;
    let scale = 1.0 / (maps[first].n + 1.0);
    let alpha = log((maps[first + 1u].n + 1.0) * scale);
    let beta = log((maps[first + 2u].n + 1.0) * scale);
    let y = log((n + 1.0) * scale);
    let determinant = a * beta - b * alpha;
    let w1 = (x * beta - b * y) / determinant;
    let w2 = (a * y - alpha * x) / determinant;
    var logarithm = (1.0 - w1 - w2) * look_up(maps[first], uv);
    logarithm += w1 * look_up(maps[first + 1u], uv);
    logarithm += w2 * look_up(maps[first + 2u], uv);
    return exp2(logarithm);
}

// D(N).
fn irradiance(normal: vec3f) -> vec3f {
    let d = into_image(normal);
    if sky.harmonics == 0u {
        return exp2(look_up(maps[0], texture_of(d)));
    }
    var sum = 0.282095 * sky.coefficients[0].rgb;
    sum += 0.488603 * (d.y * sky.coefficients[1].rgb + d.z * sky.coefficients[2].rgb + d.x * sky.coefficients[3].rgb);
    sum += 1.092548 * (d.x * d.y * sky.coefficients[4].rgb + d.y * d.z * sky.coefficients[5].rgb);
    sum += 0.315392 * (3.0 * d.z * d.z - 1.0) * sky.coefficients[6].rgb;
    sum += 1.092548 * d.x * d.z * sky.coefficients[7].rgb;
    sum += 0.546274 * (d.x * d.x - d.y * d.y) * sky.coefficients[8].rgb;
    return max(sum, vec3f(0.0));
}

// Factor, turn and sharpness of a lobe by the cosine of its peak and its exponent.
fn clip(cosine: f32, n: f32) -> vec3f {
    if sky.horizon == 0u {
        return vec3f(max(cosine, 0.0), 0.0, 1.0);
    }
    let x = clamp(cosine * 0.5 + 0.5, 0.0, 1.0) * f32(COSINES - 1u);
    let y = clamp((log2(max(n, 1e-3)) - LOG2_LOW) / LOG2_STEP, 0.0, f32(EXPONENTS - 1u));
    let i = min(u32(x), COSINES - 2u);
    let j = min(u32(y), EXPONENTS - 2u);
    let at = j * COSINES + i;
    let lower = mix(clipped[at].xyz, clipped[at + 1u].xyz, x - f32(i));
    let upper = mix(clipped[at + COSINES].xyz, clipped[at + COSINES + 1u].xyz, x - f32(i));
    return mix(lower, upper, y - f32(j));
}

// A direction of the sample's frame turned towards +z.
fn turned(direction: vec3f, angle: f32) -> vec3f {
    let flat_length = length(direction.xy);
    if flat_length < 1e-6 {
        return direction;
    }
    let up = (vec3f(0.0, 0.0, 1.0) - direction * direction.z) / flat_length;
    return direction * cos(angle) + up * sin(angle);
}

// Bilinear between the nodes of `coats` from `at` on.
fn between(at: u32, part: vec2f) -> vec4f {
    let low = mix(coats[at], coats[at + 2u], part.y);
    let high = mix(coats[at + 2u * COATS], coats[at + 2u * COATS + 2u], part.y);
    return mix(low, high, part.x);
}

// Mean radiance under a lobe by its angle, away from the exitant direction, and its log2 n.
fn under_lobe(lobe: vec2f, frame: mat3x3f, wo: vec3f) -> vec3f {
    let n = clamp(exp2(lobe.y), maps[1].n, maps[sky.maps].n);
    let level = length(wo.xy);
    let away = select(vec2f(0.0), -wo.xy / max(level, 1e-20), level > 0.0);
    return lobe_light(frame * vec3f(away * sin(lobe.x), cos(lobe.x)), n) * ((n + 1.0) / TAU);
}

// Radiance of the environment that a microfacet term reflects.
fn distant_by_coat(coat: Coat, frame: mat3x3f, wo: vec3f) -> vec3f {
    let x = clamp(wo.z, 0.0, 1.0) * f32(COATS - 1u);
    let y = clamp(sqrt(coat.alpha), 0.0, 1.0) * f32(COATS - 1u);
    let i = min(u32(x), COATS - 2u);
    let j = min(u32(y), COATS - 2u);
    let at = 2u * (i * COATS + j);
    let part = vec2f(x - f32(i), y - f32(j));
    let whole = between(at, part);
    let lobes = between(at + 1u, part);
    let light = whole.z * under_lobe(lobes.xy, frame, wo) + (1.0 - whole.z) * under_lobe(lobes.zw, frame, wo);
    return (coat.f0 * whole.x + coat.f90 * whole.y) * light;
}

// Radiance of the environment that a texel reflects; `diffuse` is D(N).
fn distant(object: u32, index: u32, brightest: f32, diffuse: vec3f, frame: mat3x3f, wo: vec3f) -> vec3f {
    var at = starts[index];
    let end = starts[index + 1u] - coat_words(object);
    let texel = texel_at(at, brightest);
    var radiance = texel.rho_d * diffuse;
    for (at += header_words(); at < end; at += 2u * GROUP) {
        let lobe = lobe_at(at, texel, brightest);
        let peak = peak_of(lobe, wo);
        let size = length(peak);
        if size <= 1e-18 {
            continue;
        }
        // Of a lobe that sharpens that at its peak.
        let own = exponent(lobe, wo.z + max(peak.z / size, 0.0));
        let part = clip(peak.z / size, own);
        if part.x > 0.0 {
            let n = clamp((own + 1.0) * part.z - 1.0, maps[1].n, maps[sky.maps].n);
            let light = lobe_light(frame * turned(peak / size, part.y), n);
            radiance += lobe.rho_s * light * (pow(size, own) * part.x * (n + 1.0) / (own + 1.0));
        }
    }
    for (; at < starts[index + 1u]; at += 2u * GROUP) {
        radiance += distant_by_coat(coat_at(at, brightest), frame, wo);
    }
    return radiance;
}

// The same over a footprint.
fn distant_of(object: u32, footprint: Footprint, frame: mat3x3f, wo: vec3f) -> vec3f {
    let diffuse = irradiance(frame[2]);
    let brightest = materials[object].brightest;
    let count = tap_count(footprint);
    var radiance = vec3f(0.0);
    for (var k = 0u; k < count; k++) {
        let one = tap(object, footprint, k);
        if one.weight > 0.0 {
            radiance += one.weight * distant(object, one.texel, brightest, diffuse, frame, wo);
        }
    }
    return radiance;
}
