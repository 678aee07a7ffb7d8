// Shadow rays and where the material is; part of lights.wgsl.

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
