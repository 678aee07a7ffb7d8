// Lights without extent on SBRDF materials, any number of lobes and lamps in one pass, with shadows:
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
    // Directional: unit vector toward the light, w = 0. Point: position, w = 1.
    place: vec4f,
    // Directional: irradiance. Point: intensity.
    power: vec4f,
    // Normal of a point's surface, whose cosine counts; zero for a light that is the same all round.
    front: vec4f,
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
}

// A node of the tree of triangles: its box; for leaves the run of triangles, else the first of two children and a count of 0.
struct Node {
    low: vec3f,
    first: u32,
    high: vec3f,
    count: u32,
}

// 32-bit words of four coefficients: 4 in f32, 2 in f16, 1 in 8 bits.
override GROUP: u32 = 4u;
// Whether 8 bits hold C scaled to a largest base of 1 and the exponent's logarithm.
override SCALED: bool = false;
// Whether coefficients are interpolated rather than reflectance.
override COEFFICIENTS: bool = false;
// Whether the pixel's footprint is sampled on the finest level, rather than along its longer axis on MIP levels.
override SHADED: bool = false;
// Samples along an axis of the footprint at most.
override ANISOTROPY: u32 = 16u;
override SHADOWS: bool = true;
// Samples a pixel at edges.
override SAMPLES: u32 = 1u;

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
// Triangle and object, in the tree's order.
@group(0) @binding(8) var<storage, read> leaves: array<vec2u>;

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

// rho_d, and what C takes to turn it by beta: its half range along x and y is turned by twice that angle.
struct Texel {
    rho_d: vec3f,
    cos_2beta: f32,
    sin_2beta: f32,
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
    return Texel(raw.rgb, cos_beta * cos_beta - sin_beta * sin_beta, 2.0 * sin_beta * cos_beta);
}

struct Lobe {
    // C' xx, xy, yy, zz.
    c: vec4f,
    rho_s: vec3f,
    n: f32,
}

fn lobe_at(at: u32, texel: Texel, brightest: f32) -> Lobe {
    var shine = group(at);
    var c = group(at + GROUP).xyz;
    if GROUP == 1u {
        if SCALED {
            // ln 0.5 to ln 5000.
            shine = vec4f(shine.rgb * brightest, exp(-0.6931471806 + shine.a * 9.2103403720));
            c = with_sign(c);
        } else {
            shine = vec4f(shine.rgb, shine.a * 255.0);
            c = c * 2.0 - 1.0;
        }
    }
    let mean = 0.5 * (c.x + c.y);
    let half_range = 0.5 * (c.x - c.y);
    let along = half_range * texel.cos_2beta;
    return Lobe(vec4f(mean + along, half_range * texel.sin_2beta, mean - along, c.z), shine.rgb, shine.a);
}

// The lobes are diagonal but for xy, so products of components are all that they need.
fn pairs_of(wi: vec3f, wo: vec3f) -> vec4f {
    return vec4f(wi.x * wo.x, wi.x * wo.y + wi.y * wo.x, wi.y * wo.y, wi.z * wo.z);
}

fn power(base: f32, n: f32) -> f32 {
    return select(0.0, pow(max(base, 1e-37), n), base > 0.0);
}

// Lamps that are shaded together: texels are read once for all of them.
const TOGETHER = 4u;

// Light at a point.
struct Lit {
    // Products of the directions' components, as lobes need them.
    pairs: array<vec4f, TOGETHER>,
    // Irradiance of the surface.
    light: array<vec3f, TOGETHER>,
    // Of all.
    sum: vec3f,
    count: u32,
}

// Radiance by a lobe.
fn by_lobe(lobe: Lobe, lit: ptr<function, Lit>) -> vec3f {
    var sum = vec3f(0.0);
    for (var k = 0u; k < (*lit).count; k++) {
        sum += (*lit).light[k] * power(dot(lobe.c, (*lit).pairs[k]), lobe.n);
    }
    return lobe.rho_s * sum;
}

// Radiance by a texel.
fn by_texel(index: u32, brightest: f32, lit: ptr<function, Lit>) -> vec3f {
    var at = starts[index];
    let end = starts[index + 1u];
    let texel = texel_at(at, brightest);
    var radiance = texel.rho_d * (*lit).sum;
    for (at += GROUP; at < end; at += 2u * GROUP) {
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
}

fn footprint_of(object: u32, uv: vec2f, dx: vec2f, dy: vec2f) -> Footprint {
    let size = vec2f(f32(materials[object].width), f32(materials[object].height));
    let scale = materials[object].tiling * size;
    let x = dx * scale;
    let y = dy * scale;
    let long_x = length(x);
    let long_y = length(y);
    var out = Footprint(fract(uv * materials[object].tiling) * size, x, y, vec2u(1u), 0.0);
    let most = f32(ANISOTROPY);
    if SHADED {
        if materials[object].width * materials[object].height > 1u {
            out.counts = vec2u(clamp(ceil(vec2f(long_x, long_y)), vec2f(1.0), vec2f(most)));
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
fn tap_count(object: u32, footprint: Footprint) -> u32 {
    let levels = select(1u, 2u, fract(footprint.level) > 0.0);
    return footprint.counts.x * footprint.counts.y * levels * select(1u, 4u, materials[object].bilinear != 0u);
}

fn tap(object: u32, footprint: Footprint, index: u32) -> Tap {
    var rest = index;
    var weight = 1.0;
    var neighbour = 0u;
    if materials[object].bilinear != 0u {
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
    if materials[object].bilinear != 0u {
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
    let count = tap_count(object, footprint);
    var radiance = vec3f(0.0);
    if !COEFFICIENTS {
        for (var k = 0u; k < count; k++) {
            let one = tap(object, footprint, k);
            if one.weight > 0.0 {
                radiance += one.weight * by_texel(one.texel, brightest, lit);
            }
        }
        return radiance;
    }
    // A lobe that one texel lacks has its shape from the others.
    for (var j = 0u; j == 0u || j < materials[object].lobes; j++) {
        var sum = Lobe(vec4f(0.0), vec3f(0.0), 0.0);
        var whole = 0.0;
        for (var k = 0u; k < count; k++) {
            let one = tap(object, footprint, k);
            let texel = texel_at(starts[one.texel], brightest);
            if j == 0u {
                radiance += one.weight * texel.rho_d * (*lit).sum;
            }
            let at = starts[one.texel] + GROUP * (1u + 2u * j);
            if one.weight > 0.0 && at < starts[one.texel + 1u] {
                let lobe = lobe_at(at, texel, brightest);
                sum.c += one.weight * lobe.c;
                sum.rho_s += one.weight * lobe.rho_s;
                sum.n += one.weight * lobe.n;
                whole += one.weight;
            }
        }
        if whole > 0.0 {
            radiance += by_lobe(Lobe(sum.c / whole, sum.rho_s, sum.n / whole), lit);
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
fn meets(leaf: vec2u, origin: vec3f, direction: vec3f, reach: f32) -> bool {
    const MARGIN = -1e-6;
    let a = corner_of(leaf.x, 0u);
    let e1 = a - corner_of(leaf.x, 1u);
    let e2 = corner_of(leaf.x, 2u) - a;
    let normal = cross(e1, e2);
    let c = a - origin;
    let r = cross(direction, c);
    let inverse = 1.0 / dot(normal, direction);
    let u = dot(r, e2) * inverse;
    let v = dot(r, e1) * inverse;
    let t = dot(normal, c) * inverse;
    if !(u >= MARGIN && v >= MARGIN && u + v <= 1.0 - MARGIN && t >= 0.0 && t <= reach) {
        return false;
    }
    if materials[leaf.y].mask.y == 0u {
        return true;
    }
    let corners = vec3u(triangles[3u * leaf.x], triangles[3u * leaf.x + 1u], triangles[3u * leaf.x + 2u]);
    let uv = vertices[3u * corners.x + 2u].zw * (1.0 - u - v)
        + vertices[3u * corners.y + 2u].zw * u + vertices[3u * corners.z + 2u].zw * v;
    return is_solid(leaf.y, uv);
}

// Whether anything lies on a ray from its origin to its reach.
fn occluded(origin: vec3f, direction: vec3f, reach: f32) -> bool {
    let safe = select(direction, vec3f(1e-18), abs(direction) < vec3f(1e-18));
    let inverse = 1.0 / safe;
    var stack: array<u32, 96>;
    var depth = 0;
    var index = 0u;
    loop {
        let node = nodes[index];
        let a = (node.low - origin) * inverse;
        let b = (node.high - origin) * inverse;
        let near = min(a, b);
        let far = max(a, b);
        let enters = max(max(near.x, near.y), max(near.z, 0.0));
        // The margin is that of rounding.
        let leaves_at = min(min(far.x, far.y), min(far.z, reach)) * 1.000001;
        if enters <= leaves_at {
            if node.count == 0u {
                stack[depth] = node.first + 1u;
                depth++;
                index = node.first;
                continue;
            }
            for (var k = node.first; k < node.first + node.count; k++) {
                if meets(leaves[k], origin, direction, reach) {
                    return true;
                }
            }
        }
        if depth == 0 {
            break;
        }
        depth--;
        index = stack[depth];
    }
    return false;
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
    let wb = clamp(dot(cross(to, ac), normal) / area, 0.0, 1.0);
    let wc = clamp(dot(cross(ab, to), normal) / area, 0.0, 1.0);
    let weights = vec3f(max(1.0 - wb - wc, 0.0), wb, wc);
    var lift = vec3f(0.0);
    for (var k = 0u; k < 3u; k++) {
        let first = vertices[corners[k]];
        var outward = vec3f(first.w, vertices[corners[k] + 1u].xy);
        outward *= select(1.0, -1.0, dot(outward, geometric) < 0.0);
        lift -= outward * (min(dot(position - first.xyz, outward), 0.0) * weights[k]);
    }
    return position + lift + geometric * view.offset.x;
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
    let lamp_count = u32(view.eye.w);
    for (var l = 0u; l < lamp_count; l++) {
        let lamp = lamps[l];
        var toward = lamp.place.xyz;
        var irradiance = lamp.power.rgb;
        var reach = 3e38;
        if lamp.place.w != 0.0 {
            let offset = lamp.place.xyz - in.position;
            let square = max(dot(offset, offset), 1e-37);
            toward = offset * inverseSqrt(square);
            irradiance /= square;
            reach = sqrt(square) * (1.0 - 1e-5) - 3.0 * view.offset.x;
        }
        if any(lamp.front.xyz != vec3f(0.0)) {
            irradiance *= max(-dot(lamp.front.xyz, toward), 0.0);
        }
        let wi = toward * frame;
        var reaches = wi.z > 0.0 && any(irradiance > vec3f(0.0));
        if SHADOWS && reaches {
            reaches = dot(geometric, toward) > 0.0 && !occluded(origin, toward, reach);
        }
        if reaches {
            lit.pairs[lit.count] = pairs_of(wi, wo);
            lit.light[lit.count] = irradiance * wi.z;
            lit.sum += irradiance * wi.z;
            lit.count++;
        }
        if lit.count == TOGETHER || (l + 1u == lamp_count && lit.count > 0u) {
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
