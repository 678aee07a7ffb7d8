// Lights and their samples; part of lights.wgsl. See render/shading.rs.

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
