// Lights on SBRDF materials, any number of lobes and lamps in one pass, with shadows:
// L = sum over lights of (rho_d + sum over lobes of rho_s (wi C' wo)^n) E_l (N . wi)   (4.1), (6.9)
// Reflectance, not its parameters, is interpolated between texels, unless FILTERING says otherwise. The twin in Rust is
// host/render/src/render/lights/cpu.rs; coefficients are laid out by host/render/src/render/storage.rs. To this file, bindings and the pass, are
// appended the parts in lights/ and `distant_of`, what is reflected of light from afar: environment.wgsl, or nothing.

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
