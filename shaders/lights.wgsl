// Lights without extent on SBRDF materials, any number of lobes and lamps in one pass:
// L = sum over lights of (rho_d + sum over lobes of rho_s (wi C' wo)^n) E_l (N . wi)   (4.1), (6.9)
// Reflectance, not its parameters, is interpolated between texels. `distant`, what a texel reflects of light from afar, is
// appended to this file: environment.wgsl, or nothing. The twin in Rust is host/src/render/lights/cpu.rs.

struct View {
    // World to clip space.
    projection: mat4x4f,
    // Centre of projection; w: number of lamps.
    eye: vec4f,
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
    first: u32,
    width: u32,
    height: u32,
    bilinear: u32,
    tiling: vec2f,
    padding: vec2f,
    // Of a rectangular light's front.
    emission: vec3f,
    emits: u32,
}

struct Texel {
    rho_d: vec3f,
    first: u32,
    count: u32,
}

struct Lobe {
    // C' xx, xy, yy, zz.
    c: vec4f,
    rho_s: vec3f,
    n: f32,
}

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> lamps: array<Lamp>;
@group(0) @binding(2) var<storage, read> materials: array<Material>;
@group(0) @binding(3) var<storage, read> texels: array<Texel>;
@group(0) @binding(4) var<storage, read> lobes: array<Lobe>;

struct Corner {
    @location(0) position: vec3f,
    @location(1) normal: vec3f,
    // w: handedness.
    @location(2) tangent: vec4f,
    @location(3) uv: vec2f,
    @builtin(instance_index) object: u32,
}

struct Fragment {
    @builtin(position) clip: vec4f,
    @location(0) @interpolate(perspective, centroid) position: vec3f,
    @location(1) @interpolate(perspective, centroid) normal: vec3f,
    @location(2) @interpolate(perspective, centroid) tangent: vec4f,
    @location(3) @interpolate(perspective, centroid) uv: vec2f,
    @location(4) @interpolate(flat) object: u32,
}

@vertex
fn place(corner: Corner) -> Fragment {
    var out: Fragment;
    out.clip = view.projection * vec4f(corner.position, 1.0);
    out.position = corner.position;
    out.normal = corner.normal;
    out.tangent = corner.tangent;
    out.uv = corner.uv;
    out.object = corner.object;
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

// Reflectance of one texel, sr^-1.
fn evaluate(texel: u32, wi: vec3f, wo: vec3f) -> vec3f {
    // The lobes are diagonal but for xy, so products of components are all that they need.
    let pairs = vec4f(wi.x * wo.x, wi.x * wo.y + wi.y * wo.x, wi.y * wo.y, wi.z * wo.z);
    var reflectance = texels[texel].rho_d;
    let first = texels[texel].first;
    let end = first + texels[texel].count;
    for (var j = first; j < end; j++) {
        let base = dot(lobes[j].c, pairs);
        if base > 0.0 {
            reflectance += lobes[j].rho_s * pow(base, lobes[j].n);
        }
    }
    return reflectance;
}

fn texel_index(object: u32, x: i32, y: i32) -> u32 {
    let size = vec2i(i32(materials[object].width), i32(materials[object].height));
    let wrapped = ((vec2i(x, y) % size) + size) % size;
    return materials[object].first + u32(wrapped.y * size.x + wrapped.x);
}

@fragment
fn shade(in: Fragment) -> @location(0) vec4f {
    let toward_eye = normalize(view.eye.xyz - in.position);
    // The side is told by where the viewer stands, not by the triangle's winding, which files get wrong.
    let face = cross(dpdx(in.position), dpdy(in.position));
    let side = select(-1.0, 1.0, dot(in.normal, face) * dot(toward_eye, face) >= 0.0);
    if materials[in.object].emits != 0u {
        return vec4f(select(vec3f(0.0), materials[in.object].emission, dot(in.normal, toward_eye) > 0.0), 1.0);
    }
    let frame = shading_frame(in.normal * side, in.tangent.xyz, in.tangent.w * side, toward_eye);
    let wo = toward_eye * frame;

    let size = vec2f(f32(materials[in.object].width), f32(materials[in.object].height));
    let place = fract(in.uv * materials[in.object].tiling) * size;
    var weights = vec4f(1.0, 0.0, 0.0, 0.0);
    var corner = vec2i(floor(place));
    if materials[in.object].bilinear != 0u {
        let low = floor(place - 0.5);
        let f = place - 0.5 - low;
        corner = vec2i(low);
        weights = vec4f((1.0 - f.x) * (1.0 - f.y), f.x * (1.0 - f.y), (1.0 - f.x) * f.y, f.x * f.y);
    }
    let neighbours = vec4u(
        texel_index(in.object, corner.x, corner.y),
        texel_index(in.object, corner.x + 1, corner.y),
        texel_index(in.object, corner.x, corner.y + 1),
        texel_index(in.object, corner.x + 1, corner.y + 1),
    );

    var radiance = vec3f(0.0);
    for (var l = 0u; l < u32(view.eye.w); l++) {
        let lamp = lamps[l];
        var toward = lamp.place.xyz;
        var irradiance = lamp.power.rgb;
        if lamp.place.w != 0.0 {
            let offset = lamp.place.xyz - in.position;
            let square = max(dot(offset, offset), 1e-37);
            toward = offset * inverseSqrt(square);
            irradiance /= square;
        }
        if any(lamp.front.xyz != vec3f(0.0)) {
            irradiance *= max(-dot(lamp.front.xyz, toward), 0.0);
        }
        let wi = toward * frame;
        if wi.z <= 0.0 {
            continue;
        }
        var reflectance = vec3f(0.0);
        for (var k = 0; k < 4; k++) {
            if weights[k] > 0.0 {
                reflectance += weights[k] * evaluate(neighbours[k], wi, wo);
            }
        }
        radiance += reflectance * irradiance * wi.z;
    }
    for (var k = 0; k < 4; k++) {
        if weights[k] > 0.0 {
            radiance += weights[k] * distant(neighbours[k], frame, wo);
        }
    }
    return vec4f(radiance, 1.0);
}
