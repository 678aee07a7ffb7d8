// One slice of a prefiltered environment: the root S(w_p, n)^(1/n), S = integral of (w_p . w_i)^n L_i dw_i   (6.16)
// The twin in Rust is host/render/src/render/environment/source.rs.

struct Task {
    // Points of light a row, rows.
    source: vec2u,
    // Pixels a row, rows.
    map: vec2u,
    n: f32,
    // Where the lobe ends, and its angle.
    least_cosine: f32,
    reach: f32,
    // First pixel of this dispatch.
    first: u32,
}

@group(0) @binding(0) var<uniform> job: Task;
// Unit directions; grid of equal angles, row 0 at +y.
@group(0) @binding(1) var<storage, read> directions: array<vec4f>;
// Radiance times solid angle.
@group(0) @binding(2) var<storage, read> flux: array<vec4f>;
@group(0) @binding(3) var<storage, read_write> map: array<vec4f>;

const PI = 3.14159265;
const TAU = 6.28318531;

// Half the range of azimuth of a cap on a circle of latitude; 0 where they do not meet.
fn half_azimuth(toward: vec3f, reach: f32, polar: f32) -> f32 {
    let angle = clamp(polar, 0.0, PI);
    let along = sin(angle) * sqrt(max(1.0 - toward.y * toward.y, 0.0));
    let needed = cos(min(reach, PI)) - cos(angle) * toward.y;
    if along <= 1e-6 {
        return select(0.0, PI, needed <= 0.0);
    }
    if needed >= along {
        return 0.0;
    }
    return acos(max(needed / along, -1.0));
}

fn filtered(toward: vec3f) -> vec3f {
    let rows = f32(job.source.y);
    let columns = i32(job.source.x);
    let polar = acos(clamp(toward.y, -1.0, 1.0));
    let low = u32(max((polar - job.reach) / PI * rows - 1.0, 0.0));
    let high = min(u32((polar + job.reach) / PI * rows + 2.0), job.source.y);
    let pitch = PI / rows;
    let middle = (0.5 + atan2(toward.x, -toward.z) / TAU) * f32(columns);
    var sum = vec3f(0.0);
    for (var row = low; row < high; row++) {
        var widest = 0.0;
        for (var k = 0; k <= 4; k++) {
            let at = (f32(row) - 0.5 + 0.5 * f32(k)) * pitch;
            widest = max(widest, half_azimuth(toward, job.reach + 0.5 * pitch, at));
        }
        if widest <= 0.0 {
            continue;
        }
        let half = widest / TAU * f32(columns) + 1.0;
        var first = 0;
        var count = columns;
        if 2.0 * half + 1.0 < f32(columns) {
            first = i32(floor(middle - half));
            count = i32(ceil(middle + half)) - first;
        }
        for (var k = 0; k < count; k++) {
            let column = (first + k + columns) % columns;
            let index = row * job.source.x + u32(column);
            let base = dot(directions[index].xyz, toward);
            if base > job.least_cosine {
                sum += flux[index].rgb * pow(base, job.n);
            }
        }
    }
    return sum;
}

@compute @workgroup_size(64)
fn prefilter(@builtin(global_invocation_id) id: vec3u) {
    let index = job.first + id.x;
    if index >= job.map.x * job.map.y {
        return;
    }
    // The first and the last row are the poles.
    let polar = f32(index / job.map.x) / f32(job.map.y - 1) * PI;
    let azimuth = ((f32(index % job.map.x) + 0.5) / f32(job.map.x) - 0.5) * TAU;
    let toward = vec3f(sin(polar) * sin(azimuth), cos(polar), -sin(polar) * cos(azimuth));
    let light = filtered(toward);
    map[index] = vec4f(select(vec3f(0.0), pow(light, vec3f(1.0 / job.n)), light > vec3f(0.0)), 1.0);
}
