// Lights on SBRDF materials, any number of lobes and lamps in one pass, with shadows:
// L = sum over lights of (rho_d + sum over lobes of rho_s (wi C' wo)^n) E_l (N . wi)   (4.1), (6.9)
// Reflectance, not its parameters, is interpolated between texels, unless FILTERING says otherwise. The twin in Rust is
// host/src/render/lights/cpu.rs; coefficients are laid out by host/src/render/storage.rs. `distant_of`, what is reflected of light
// from afar, is appended to this file: environment.wgsl, or nothing.

struct View {
    // World to clip space.
    projection: mat4x4f,
    // Centre of projection; w: number of lamps.
    eye: vec4f,
    // Length by which shadow rays are kept off surfaces.
    offset: vec4f,
}

struct Lamp {
    // Directional: unit vector toward the light, w = 0. Point: position, w = 1. Rectangle: centre, w = 2.
    place: vec4f,
    // Directional: irradiance. Point: intensity. Rectangle: radiance.
    power: vec4f,
    // A rectangle's edges; it shines to the side of their cross product.
    u: vec4f,
    v: vec4f,
}

struct Material {
    // Of the finest level; those of the other levels follow.
    first: u32,
    width: u32,
    height: u32,
    bilinear: u32,
    tiling: vec2f,
    // MIP levels beyond the finest.
    levels: u32,
    // The largest albedo factor, where 8 bits are scaled to it; else 1.
    brightest: f32,
    // Of a rectangular light's front.
    emission: vec3f,
    emits: u32,
    // First word, columns and rows of the bits that say where the material is; none for 0 columns.
    mask: vec3u,
    // Most lobes of a texel.
    lobes: u32,
    // Microfacet terms of every texel.
    coats: u32,
}

// A node of the tree of triangles, a node's first child after it: its box; for leaves the run of triangles, else a count of 0 and
// the node that follows its last descendant.
struct Node {
    low: vec3f,
    first: u32,
    high: vec3f,
    count: u32,
}

// A triangle in the tree's order.
struct Leaf {
    corner: vec3f,
    triangle: u32,
    // From the second corner to the first, and from the first to the third.
    e1: vec3f,
    object: u32,
    e2: vec3f,
}

// 32-bit words of four coefficients: 4 in f32, 2 in f16, 1 in 8 bits.
override GROUP: u32 = 4u;
// Whether 8 bits hold C scaled to a largest base of 1 and the exponent's logarithm.
override SCALED: bool = false;
// Whether texels have a normal of their own for their lobes and lobes an exponent toward grazing.
override EXTENDED: bool = false;
// Whether coefficients are interpolated rather than reflectance.
override COEFFICIENTS: bool = false;
// Whether the pixel's footprint is sampled on the finest level, rather than along its longer axis on MIP levels.
override SHADED: bool = false;
// Samples along an axis of the footprint at most.
override ANISOTROPY: u32 = 16u;
override SHADOWS: bool = true;
// Samples a pixel at edges.
override SAMPLES: u32 = 1u;
// Samples of a rectangular light along an edge at most.
override ACROSS: u32 = 4u;

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> lamps: array<Lamp>;
@group(0) @binding(2) var<storage, read> materials: array<Material>;
// The first word of every texel, and the end of the last.
@group(0) @binding(3) var<storage, read> starts: array<u32>;
// Texels, then masks.
@group(0) @binding(4) var<storage, read> words: array<u32>;
// Three a vertex: position, normal, tangent, handedness, texture coordinates.
@group(0) @binding(5) var<storage, read> vertices: array<vec4f>;
// Three vertices a triangle.
@group(0) @binding(6) var<storage, read> triangles: array<u32>;
@group(0) @binding(7) var<storage, read> nodes: array<Node>;
@group(0) @binding(8) var<storage, read> leaves: array<Leaf>;

struct Fragment {
    @builtin(position) clip: vec4f,
    @location(0) @interpolate(perspective, centroid) position: vec3f,
    @location(1) @interpolate(perspective, centroid) normal: vec3f,
    // w: handedness.
    @location(2) @interpolate(perspective, centroid) tangent: vec4f,
    @location(3) @interpolate(perspective, centroid) uv: vec2f,
    @location(4) @interpolate(flat) object: u32,
    @location(5) @interpolate(flat) triangle: u32,
}

@vertex
fn place(@builtin(vertex_index) corner: u32, @builtin(instance_index) object: u32) -> Fragment {
    let at = 3u * triangles[corner];
    let a = vertices[at];
    let b = vertices[at + 1u];
    let c = vertices[at + 2u];
    var out: Fragment;
    out.clip = view.projection * vec4f(a.xyz, 1.0);
    out.position = a.xyz;
    out.normal = vec3f(a.w, b.xy);
    out.tangent = vec4f(b.zw, c.xy);
    out.uv = c.zw;
    out.object = object;
    out.triangle = corner / 3u;
    return out;
}

const LEAST_COSINE = 0.01;

// Any unit vector perpendicular to n.
fn perpendicular(n: vec3f) -> vec3f {
    if abs(n.x) > abs(n.y) {
        return normalize(vec3f(-n.z, 0.0, n.x));
    }
    return normalize(vec3f(0.0, n.z, -n.y));
}

// The sample's axes as columns; see render/geometry.rs, shading_frame.
fn shading_frame(normal: vec3f, tangent: vec3f, handedness: f32, toward: vec3f) -> mat3x3f {
    var z = normalize(normal);
    let cosine = dot(z, toward);
    if cosine < LEAST_COSINE {
        z = normalize(z + toward * (LEAST_COSINE - cosine));
    }
    let along = tangent - z * dot(z, tangent);
    let square = dot(along, along);
    var x = along * inverseSqrt(max(square, 1e-30));
    if square < 1e-20 {
        x = perpendicular(z);
    }
    return mat3x3f(x, cross(z, x) * handedness, z);
}

// ---- Coefficients ----

// Four coefficients: as they are, or in 0..1 where they have 8 bits.
fn group(at: u32) -> vec4f {
    if GROUP == 4u {
        return bitcast<vec4f>(vec4u(words[at], words[at + 1u], words[at + 2u], words[at + 3u]));
    }
    if GROUP == 2u {
        return vec4f(unpack2x16float(words[at]), unpack2x16float(words[at + 1u]));
    }
    return unpack4x8unorm(words[at]);
}

// From 0..1 in steps of 1/255 to -1..1 in steps of 1/127.
fn with_sign(part: vec3f) -> vec3f {
    return (part * 255.0 - 127.0) / 127.0;
}

// rho_d, and what C takes to turn it by beta: its half range along x and y is turned by twice that angle; x and y of the normal about
// which the lobes stand.
struct Texel {
    rho_d: vec3f,
    cos_2beta: f32,
    sin_2beta: f32,
    normal: vec2f,
}

// Words of a texel before its lobes.
fn header_words() -> u32 {
    return select(GROUP, 2u * GROUP, EXTENDED);
}

fn texel_at(at: u32, brightest: f32) -> Texel {
    var raw = group(at);
    if GROUP == 1u {
        raw = vec4f(raw.rgb * brightest, with_sign(raw.aaa).x);
    }
    // raw.w is tan(beta / 2).
    let square = raw.w * raw.w;
    let scale = 1.0 / (1.0 + square);
    let cos_beta = (1.0 - square) * scale;
    let sin_beta = 2.0 * raw.w * scale;
    var normal = vec2f(0.0);
    if EXTENDED {
        let more = group(at + GROUP).xyz;
        normal = select(more, with_sign(more), GROUP == 1u).xy;
    }
    return Texel(raw.rgb, cos_beta * cos_beta - sin_beta * sin_beta, 2.0 * sin_beta * cos_beta, normal);
}

struct Lobe {
    // C' xx, xy, yy, zz.
    c: vec4f,
    // C' xz, yz, 0 about the surface's own normal.
    tilt: vec2f,
    rho_s: vec3f,
    n: f32,
    // Exponent toward grazing (6.19).
    n_grazing: f32,
}

// An exponent of 8 bits.
fn exponent_of(part: f32) -> f32 {
    // ln 0.5 to ln 5000.
    return select(part * 255.0, exp(-0.6931471806 + part * 9.2103403720), SCALED);
}

fn lobe_at(at: u32, texel: Texel, brightest: f32) -> Lobe {
    var shine = group(at);
    var shape = group(at + GROUP);
    if GROUP == 1u {
        shine = vec4f(shine.rgb * brightest, exponent_of(shine.a));
        shape = vec4f(select(shape.xyz * 2.0 - 1.0, with_sign(shape.xyz), SCALED), shape.w);
        if EXTENDED {
            shape.w = exponent_of(shape.w);
        }
    }
    let mean = 0.5 * (shape.x + shape.y);
    let half_range = 0.5 * (shape.x - shape.y);
    let along = half_range * texel.cos_2beta;
    let c = vec4f(mean + along, half_range * texel.sin_2beta, mean - along, shape.z);
    let lobe = Lobe(c, vec2f(0.0), shine.rgb, shine.a, shape.w);
    if EXTENDED {
        return tilted(lobe, texel.normal);
    }
    return lobe;
}

// A lobe about a normal: directions take the shortest turn that brings the normal to z before they meet C'.
fn tilted(lobe: Lobe, normal: vec2f) -> Lobe {
    let z = sqrt(max(1.0 - dot(normal, normal), 0.0));
    let less = normal / (1.0 + z);
    let turn = mat3x3f(
        vec3f(1.0 - less.x * normal.x, -less.x * normal.y, normal.x),
        vec3f(-less.y * normal.x, 1.0 - less.y * normal.y, normal.y),
        vec3f(-normal, z),
    );
    let about_z = mat3x3f(vec3f(lobe.c.xy, 0.0), vec3f(lobe.c.yz, 0.0), vec3f(0.0, 0.0, lobe.c.w));
    let c = transpose(turn) * about_z * turn;
    return Lobe(vec4f(c[0].xy, c[1].y, c[2].z), c[2].xy, lobe.rho_s, lobe.n, lobe.n_grazing);
}

// C' w_o: a lobe's base is its dot product with w_i.
fn peak_of(lobe: Lobe, wo: vec3f) -> vec3f {
    let peak = vec3f(lobe.c.x * wo.x + lobe.c.y * wo.y, lobe.c.y * wo.x + lobe.c.z * wo.y, lobe.c.w * wo.z);
    if EXTENDED {
        return peak + vec3f(lobe.tilt * wo.z, dot(lobe.tilt, wo.xy));
    }
    return peak;
}

// A lobe's exponent by the sum of the cosines of both directions (6.19).
fn exponent(lobe: Lobe, cosines: f32) -> f32 {
    return select(lobe.n, lobe.n_grazing + 0.5 * (lobe.n - lobe.n_grazing) * cosines, EXTENDED);
}

// A microfacet term; see host/reflectance/src/microfacet.rs.
struct Coat {
    f0: vec3f,
    f90: vec3f,
    alpha: f32,
}

fn coat_at(at: u32, brightest: f32) -> Coat {
    var f0 = group(at).rgb;
    var rest = group(at + GROUP);
    if GROUP == 1u {
        f0 *= brightest;
        rest = vec4f(rest.rgb * brightest, rest.a);
    }
    return Coat(f0, rest.rgb, rest.a * rest.a);
}

// Smith's Lambda.
fn lambda(cosine: f32, alpha: f32) -> f32 {
    let tan2 = max(1.0 - cosine * cosine, 0.0) / (cosine * cosine);
    return 0.5 * (sqrt(1.0 + alpha * alpha * tan2) - 1.0);
}

// Its reflectance, sr^-1, for directions above the surface.
fn reflected_by(coat: Coat, wi: vec3f, wo: vec3f) -> vec3f {
    let h = wi + wo;
    let square = dot(h, h);
    let alpha2 = coat.alpha * coat.alpha;
    let width = (h.x * h.x + h.y * h.y + alpha2 * h.z * h.z) / square;
    let shadowing = 1.0 / (1.0 + lambda(wi.z, coat.alpha) + lambda(wo.z, coat.alpha));
    let x = max(1.0 - 0.5 * sqrt(square), 0.0);
    let fresnel = coat.f0 + (coat.f90 - coat.f0) * (x * x * x * x * x);
    return fresnel * (alpha2 / (3.14159265 * width * width) * shadowing / (4.0 * wi.z * wo.z));
}

fn power(base: f32, n: f32) -> f32 {
    return select(0.0, pow(max(base, 1e-37), n), base > 0.0);
}

// Lamps that are shaded together: texels are read once for all of them.
const TOGETHER = 4u;

// Light at a point.
struct Lit {
    wo: vec3f,
    wi: array<vec3f, TOGETHER>,
    // Irradiance of the surface.
    light: array<vec3f, TOGETHER>,
    // Of all.
    sum: vec3f,
    count: u32,
}

// Radiance by a lobe.
fn by_lobe(lobe: Lobe, lit: ptr<function, Lit>) -> vec3f {
    let peak = peak_of(lobe, (*lit).wo);
    var sum = vec3f(0.0);
    for (var k = 0u; k < (*lit).count; k++) {
        let n = exponent(lobe, (*lit).wo.z + (*lit).wi[k].z);
        sum += (*lit).light[k] * power(dot(peak, (*lit).wi[k]), n);
    }
    return lobe.rho_s * sum;
}

// Words of the microfacet terms at a texel's end.
fn coat_words(object: u32) -> u32 {
    return materials[object].coats * 2u * GROUP;
}

// Radiance by a texel's microfacet terms.
fn by_coats(object: u32, index: u32, brightest: f32, lit: ptr<function, Lit>) -> vec3f {
    var radiance = vec3f(0.0);
    let end = starts[index + 1u];
    for (var at = end - coat_words(object); at < end; at += 2u * GROUP) {
        let coat = coat_at(at, brightest);
        for (var k = 0u; k < (*lit).count; k++) {
            radiance += (*lit).light[k] * reflected_by(coat, (*lit).wi[k], (*lit).wo);
        }
    }
    return radiance;
}

// Radiance by a texel.
fn by_texel(object: u32, index: u32, brightest: f32, lit: ptr<function, Lit>) -> vec3f {
    var at = starts[index];
    let end = starts[index + 1u] - coat_words(object);
    let texel = texel_at(at, brightest);
    var radiance = texel.rho_d * (*lit).sum + by_coats(object, index, brightest, lit);
    for (at += header_words(); at < end; at += 2u * GROUP) {
        radiance += by_lobe(lobe_at(at, texel, brightest), lit);
    }
    return radiance;
}

// ---- Filtering; see render/lights/footprint.rs ----

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

// ---- Shadows ----

fn corner_of(triangle: u32, corner: u32) -> vec3f {
    return vertices[3u * triangles[3u * triangle + corner]].xyz;
}

// Whether a place of the texture, whose repeats are 1 apart, is there.
fn is_solid(object: u32, uv: vec2f) -> bool {
    let mask = materials[object].mask;
    if mask.y == 0u {
        return true;
    }
    let size = mask.yz;
    let texel = min(vec2u(fract(uv * materials[object].tiling) * vec2f(size)), size - 1u);
    let index = texel.y * size.x + texel.x;
    return ((words[mask.x + (index >> 5u)] >> (index & 31u)) & 1u) != 0u;
}

// Whether a ray meets a triangle where its material is; see render/geometry.rs, intersect.
fn meets(index: u32, origin: vec3f, direction: vec3f, reach: f32) -> bool {
    const MARGIN = -1e-6;
    let e1 = leaves[index].e1;
    let e2 = leaves[index].e2;
    let normal = cross(e1, e2);
    let c = leaves[index].corner - origin;
    let r = cross(direction, c);
    let inverse = 1.0 / dot(normal, direction);
    let u = dot(r, e2) * inverse;
    let v = dot(r, e1) * inverse;
    let t = dot(normal, c) * inverse;
    if !(u >= MARGIN && v >= MARGIN && u + v <= 1.0 - MARGIN && t >= 0.0 && t <= reach) {
        return false;
    }
    let object = leaves[index].object;
    if materials[object].mask.y == 0u {
        return true;
    }
    let first = 3u * leaves[index].triangle;
    let corners = vec3u(triangles[first], triangles[first + 1u], triangles[first + 2u]);
    let uv = vertices[3u * corners.x + 2u].zw * (1.0 - u - v)
        + vertices[3u * corners.y + 2u].zw * u + vertices[3u * corners.z + 2u].zw * v;
    return is_solid(object, uv);
}

// Whether anything lies on a ray from its origin to its reach. The nodes' order needs no stack.
fn occluded(origin: vec3f, direction: vec3f, reach: f32) -> bool {
    let safe = select(direction, vec3f(1e-18), abs(direction) < vec3f(1e-18));
    let inverse = 1.0 / safe;
    let end = arrayLength(&nodes);
    var index = 0u;
    while index < end {
        let node = nodes[index];
        let a = (node.low - origin) * inverse;
        let b = (node.high - origin) * inverse;
        let near = min(a, b);
        let far = max(a, b);
        let enters = max(max(near.x, near.y), max(near.z, 0.0));
        // The margin is that of rounding.
        let leaves_at = min(min(far.x, far.y), min(far.z, reach)) * 1.000001;
        index++;
        if enters <= leaves_at {
            for (var k = node.first; k < node.first + node.count; k++) {
                if meets(k, origin, direction, reach) {
                    return true;
                }
            }
        } else if node.count == 0u {
            index = node.first;
        }
    }
    return false;
}

// ---- Lights; see render/shading.rs ----

// A well-mixed function of a 32-bit number; see render/sampler.rs.
fn hash(number: u32) -> u32 {
    var x = number;
    x ^= x >> 16u;
    x *= 0x7feb352du;
    x ^= x >> 15u;
    x *= 0x846ca68bu;
    return x ^ (x >> 16u);
}

// One sample of a light as a point sees it.
struct Seen {
    toward: vec3f,
    distance: f32,
    // On a surface that faces it.
    irradiance: vec3f,
    // Samples of this light.
    count: u32,
}

// Angle between samples of a rectangle, radians.
const SAMPLE_ANGLE = 0.1;

// Samples of a rectangle along its edges: by the angle that they span at the distance of its nearest point.
fn grid_of(lamp: Lamp, to: vec3f) -> vec2u {
    let squares = vec2f(dot(lamp.u.xyz, lamp.u.xyz), dot(lamp.v.xyz, lamp.v.xyz));
    let at = clamp(-vec2f(dot(to, lamp.u.xyz), dot(to, lamp.v.xyz)) / squares, vec2f(-0.5), vec2f(0.5));
    let nearest = to + lamp.u.xyz * at.x + lamp.v.xyz * at.y;
    let angles = sqrt(squares / max(dot(nearest, nearest), 1e-37));
    return vec2u(clamp(ceil(angles / SAMPLE_ANGLE), vec2f(1.0), vec2f(f32(ACROSS))));
}

fn see(lamp: Lamp, point: vec3f, seed: u32, k: u32) -> Seen {
    if lamp.place.w == 0.0 {
        return Seen(lamp.place.xyz, 3e38, lamp.power.rgb, 1u);
    }
    var to = lamp.place.xyz - point;
    var count = 1u;
    if lamp.place.w == 2.0 {
        let grid = grid_of(lamp, to);
        count = grid.x * grid.y;
        // A place within each cell that differs from pixel to pixel.
        let shift = vec2f(f32(seed & 0xffffu), f32(seed >> 16u)) * (1.0 / 65536.0);
        let cell = (vec2f(f32(k % grid.x), f32(k / grid.x)) + shift) / vec2f(grid) - 0.5;
        to += lamp.u.xyz * cell.x + lamp.v.xyz * cell.y;
    }
    let square = max(dot(to, to), 1e-37);
    let toward = to * inverseSqrt(square);
    var irradiance = lamp.power.rgb / square;
    if lamp.place.w == 2.0 {
        // The cross product's length is the area.
        irradiance *= max(-dot(cross(lamp.u.xyz, lamp.v.xyz), toward), 0.0) / f32(count);
    }
    return Seen(toward, sqrt(square), irradiance, count);
}

// ---- The pass ----

// Where shadow rays start: lifted to the smooth surface that the triangle stands for; see render/geometry.rs, surface.
fn shadow_origin(triangle: u32, position: vec3f, geometric: vec3f) -> vec3f {
    let corners = vec3u(triangles[3u * triangle], triangles[3u * triangle + 1u], triangles[3u * triangle + 2u]) * 3u;
    let a = vertices[corners.x].xyz;
    let ab = vertices[corners.y].xyz - a;
    let ac = vertices[corners.z].xyz - a;
    let to = position - a;
    let normal = cross(ab, ac);
    let area = max(dot(normal, normal), 1e-37);
    var wb = clamp(dot(cross(to, ac), normal) / area, 0.0, 1.0);
    var wc = clamp(dot(cross(ab, to), normal) / area, 0.0, 1.0);
    let whole = max(wb + wc, 1.0);
    wb /= whole;
    wc /= whole;
    let weights = vec3f(1.0 - wb - wc, wb, wc);
    // Within the triangle: multisampling may place fragments beyond its edges.
    let place = a + ab * wb + ac * wc;
    var lift = vec3f(0.0);
    for (var k = 0u; k < 3u; k++) {
        let first = vertices[corners[k]];
        var outward = vec3f(first.w, vertices[corners[k] + 1u].xy);
        outward *= select(1.0, -1.0, dot(outward, geometric) < 0.0);
        lift -= outward * (min(dot(place - first.xyz, outward), 0.0) * weights[k]);
    }
    return place + lift + geometric * view.offset.x;
}

fn radiance_of(in: Fragment, dx: vec2f, dy: vec2f) -> vec3f {
    let toward_eye = normalize(view.eye.xyz - in.position);
    if materials[in.object].emits != 0u {
        return select(vec3f(0.0), materials[in.object].emission, dot(in.normal, toward_eye) > 0.0);
    }
    let a = corner_of(in.triangle, 0u);
    // The side is told by where the viewer stands, not by the triangle's winding, which files get wrong.
    var geometric = normalize(cross(corner_of(in.triangle, 1u) - a, corner_of(in.triangle, 2u) - a));
    geometric *= select(-1.0, 1.0, dot(geometric, toward_eye) >= 0.0);
    let side = select(-1.0, 1.0, dot(in.normal, geometric) >= 0.0);
    // Interpolation over a triangle seen edge-on does not give back even what is the same at all corners.
    let handedness = select(-1.0, 1.0, in.tangent.w >= 0.0);
    let frame = shading_frame(in.normal * side, in.tangent.xyz, handedness * side, toward_eye);
    let wo = toward_eye * frame;
    let footprint = footprint_of(in.object, in.uv, dx, dy);
    let origin = shadow_origin(in.triangle, in.position, geometric);

    var radiance = distant_of(in.object, footprint, frame, wo);
    var lit: Lit;
    lit.wo = wo;
    let pixel = hash(u32(in.clip.x) | (u32(in.clip.y) << 16u));
    let lamp_count = u32(view.eye.w);
    var l = 0u;
    var k = 0u;
    while l < lamp_count {
        let seen = see(lamps[l], in.position, hash(pixel ^ ((l << 16u) | k)), k);
        k++;
        if k == seen.count {
            k = 0u;
            l++;
        }
        let wi = seen.toward * frame;
        var reaches = wi.z > 0.0 && any(seen.irradiance > vec3f(0.0));
        if SHADOWS && reaches {
            // Seen from where the ray starts, a near light has another direction and distance.
            var direction = seen.toward;
            var reach = 3e38;
            if seen.distance < 1e37 {
                let to = in.position + seen.toward * seen.distance - origin;
                let distance = length(to);
                direction = to / distance;
                reach = distance * (1.0 - 1e-5) - 3.0 * view.offset.x;
            }
            reaches = dot(geometric, seen.toward) > 0.0 && !occluded(origin, direction, reach);
        }
        if reaches {
            lit.wi[lit.count] = wi;
            lit.light[lit.count] = seen.irradiance * wi.z;
            lit.sum += seen.irradiance * wi.z;
            lit.count++;
        }
        if lit.count == TOGETHER || (l == lamp_count && lit.count > 0u) {
            radiance += by_footprint(in.object, footprint, &lit);
            lit.count = 0u;
            lit.sum = vec3f(0.0);
        }
    }
    return radiance;
}

@fragment
fn shade(in: Fragment) -> @location(0) vec4f {
    return vec4f(radiance_of(in, dpdxFine(in.uv), dpdyFine(in.uv)), 1.0);
}

struct Cut {
    @location(0) colour: vec4f,
    @builtin(sample_mask) mask: u32,
}

// Objects with a mask: samples of the pixel where the material is not are left out.
@fragment
fn shade_cut_out(in: Fragment) -> Cut {
    let dx = dpdxFine(in.uv);
    let dy = dpdyFine(in.uv);
    var mask = select(0u, 0xffffffffu, is_solid(in.object, in.uv));
    if SAMPLES == 4u {
        // The standard places of four samples.
        var places = array(vec2f(-0.125, -0.375), vec2f(0.375, -0.125), vec2f(-0.375, 0.125), vec2f(0.125, 0.375));
        mask = 0u;
        for (var k = 0u; k < 4u; k++) {
            let uv = in.uv + dx * places[k].x + dy * places[k].y;
            mask |= select(0u, 1u << k, is_solid(in.object, uv));
        }
    }
    if mask == 0u {
        discard;
    }
    return Cut(vec4f(radiance_of(in, dx, dy), 1.0), mask);
}
