// Shapes, as fit/model.rs and fit/separable/shape.rs.

fn largest_given(across: f32, z: f32, given: f32, limit: f32) -> f32 {
    let a = across * sin(given);
    let b = z * cos(given);
    let other = min(atan2(a, b), limit);
    return a * sin(other) + b * cos(other);
}

// The largest base within the cone.
fn reference(c: vec3f) -> f32 {
    let across = max(abs(c.x), abs(c.y));
    let largest = max(largest_given(across, c.z, cone.x, cone.y), largest_given(across, c.z, cone.y, cone.x));
    return max(max(c.z, largest), LEAST_REFERENCE);
}

fn isotropic_c(angle: f32) -> vec3f {
    let across = sin(angle) * ROOT_HALF;
    return vec3f(across, across, cos(angle));
}

// Where C of an isotropic lobe may move.
fn round_circle(c: vec3f) -> vec3f {
    return vec3f(ROOT_HALF * c.z, ROOT_HALF * c.z, -(c.x + c.y) * ROOT_HALF);
}

// A unit tangent at C; the other is their cross product.
fn tangent(c: vec3f) -> vec3f {
    let side = select(-1.0, 1.0, c.z >= 0.0);
    let a = -1.0 / (side + c.z);
    return vec3f(1.0 + side * c.x * c.x * a, side * c.x * c.y * a, -side * c.x);
}

// The linear form of a diagonal C whose first axis lies at the trial's beta.
fn turned(c: vec3f) -> vec4f {
    let s = sin(trial_beta);
    let k = cos(trial_beta);
    return vec4f(k * k * c.x + s * s * c.y, s * s * c.x + k * k * c.y, c.z, s * k * (c.x - c.y));
}

fn set_forms() {
    for (var lobe = 0u; lobe < job.lobes; lobe++) {
        let c = trial_lobes[lobe].xyz;
        let scale = 1.0 / reference(c);
        let at = lobe * FORMS;
        forms[at] = turned(c) * scale;
        if DERIVATIVES == 0u {
            continue;
        }
        if FAMILY == ANISOTROPIC {
            let u = tangent(c);
            let s = sin(trial_beta);
            let k = cos(trial_beta);
            forms[at + 1u] = turned(u) * scale;
            forms[at + 2u] = turned(cross(c, u)) * scale;
            forms[at + 3u] = vec4f(-2.0 * s * k, 2.0 * s * k, 0.0, k * k - s * s) * (c.x - c.y) * scale;
        } else {
            forms[at + 1u] = turned(round_circle(c)) * scale;
        }
        if FAMILY == SPLIT {
            forms[at + 2u] = vec4f(1.0, -1.0, 0.0, 0.0) * scale;
            forms[at + 3u] = vec4f(0.0, 0.0, 0.0, 1.0) * scale;
        }
    }
}

fn unknown(lobe: u32, column: u32) -> u32 {
    if FAMILY == ISOTROPIC {
        return 2u * lobe + column;
    }
    if FAMILY == SPLIT {
        return 4u * lobe + column;
    }
    return select(3u * lobe + column, 3u * LOBES, column == 3u);
}

// The trial: a step in `vector` from the accepted model.
fn advance() {
    trial_beta = beta;
    if FAMILY == ANISOTROPIC {
        trial_beta += clamp(vector[unknown(0u, 3u)], -0.3, 0.3);
    }
    for (var lobe = 0u; lobe < job.lobes; lobe++) {
        let c = lobes[lobe].xyz;
        let n = lobes[lobe].w * exp(clamp(vector[unknown(lobe, 0u)], -1.5, 1.5));
        var turn = vec3f(0.0);
        if FAMILY == ANISOTROPIC {
            let u = tangent(c);
            turn = u * vector[unknown(lobe, 1u)] + cross(c, u) * vector[unknown(lobe, 2u)];
        } else {
            turn = round_circle(c) * vector[unknown(lobe, 1u)];
        }
        turn *= min(1.0, 0.7 / max(length(turn), 1e-20));
        var moved = normalize(c + turn);
        if FAMILY != ANISOTROPIC {
            moved = isotropic_c(atan2(moved.x / ROOT_HALF, moved.z));
        }
        trial_lobes[lobe] = vec4f(moved, clamp(n, LEAST_EXPONENT, MOST_EXPONENT));
    }
}
