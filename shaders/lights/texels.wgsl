// What a texel reflects: coefficients, lobes and microfacet terms; part of lights.wgsl.

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
