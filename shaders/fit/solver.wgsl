// The solver, as fit/separable/solver.rs.

fn load(index: u32) {
    let texel = fits[index].texel;
    for (var channel = 0u; channel < 3u; channel++) {
        most[channel] = texels[texel].most[channel];
        for (var i = 0u; i <= job.lobes; i++) {
            x[channel * LINEAR + i] = fits[index].x[i][channel];
        }
    }
    whole = texels[texel].most.w;
    cone = texels[texel].cone.xy;
    beta = fits[index].beta;
    trial_beta = beta;
    for (var lobe = 0u; lobe < job.lobes; lobe++) {
        lobes[lobe] = fits[index].lobes[lobe];
        trial_lobes[lobe] = lobes[lobe];
    }
    set_forms();
}

fn accept(next: f32) {
    set_normal();
    cost = next;
    beta = trial_beta;
    for (var lobe = 0u; lobe < job.lobes; lobe++) {
        lobes[lobe] = trial_lobes[lobe];
    }
    for (var i = 0u; i < 3u * (job.lobes + 1u); i++) {
        x[i] = trial_x[i];
    }
}

fn dampen() -> bool {
    damping *= growth;
    growth *= 4.0;
    return damping <= 1e9;
}

// Makes the next trial; false where there is nothing more to gain.
fn propose() -> bool {
    if cost <= 1e-13 * whole {
        return false;
    }
    while !solve_step() {
        if !dampen() {
            return false;
        }
    }
    predicted = promised();
    if damping > 1e9 || (predicted <= job.tolerance * cost && damping <= 1.0) {
        return false;
    }
    advance();
    set_forms();
    return true;
}

fn judge() {
    let next = solve_amplitudes();
    if next < cost {
        let gain = 2.0 * (cost - next) / max(predicted, 1e-30) - 1.0;
        damping = max(damping * clamp(1.0 - gain * gain * gain, 0.1, 1.0), 1e-12);
        growth = 4.0;
        accept(next);
    } else {
        dampen();
    }
}

fn store(index: u32) {
    fits[index].beta = beta;
    fits[index].cost = cost;
    for (var lobe = 0u; lobe < job.lobes; lobe++) {
        fits[index].lobes[lobe] = lobes[lobe];
    }
    for (var i = 0u; i <= job.lobes; i++) {
        fits[index].x[i] = vec4f(x[i], x[LINEAR + i], x[2u * LINEAR + i], 0.0);
    }
}

@compute @workgroup_size(32)
fn minimise(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) lane: u32) {
    let index = job.first + group.x;
    let texel = fits[index].texel;
    if lane == 0u {
        load(index);
    }
    make_gram(texel, lane);
    if lane == 0u {
        damping = 1e-3;
        growth = 4.0;
        accept(solve_amplitudes());
    }
    for (var step = 0u; step < job.iterations; step++) {
        if lane == 0u {
            running = select(0u, 1u, propose());
        }
        if workgroupUniformLoad(&running) == 0u {
            break;
        }
        make_gram(texel, lane);
        if lane == 0u {
            judge();
        }
    }
    if lane == 0u {
        store(index);
    }
}

// Gives isotropic lobes a direction, as `spread` of fit/separable/start.rs; for the family SPLIT.
@compute @workgroup_size(32)
fn spread(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) lane: u32) {
    let index = job.first + group.x;
    if lane == 0u {
        load(index);
    }
    make_gram(fits[index].texel, lane);
    if lane != 0u {
        return;
    }
    accept(solve_amplitudes());
    damping = 1e-3;
    if !solve_step() {
        return;
    }
    var across = vec2f(0.0);
    for (var lobe = 0u; lobe < job.lobes; lobe++) {
        let at = unknown(lobe, 2u);
        let step = vec2f(vector[at], vector[at + 1u]);
        let information = normal[at * UNKNOWNS + at] + normal[(at + 1u) * UNKNOWNS + at + 1u];
        across += information * vec2f(step.x * step.x - step.y * step.y, 2.0 * step.x * step.y);
    }
    let double = 0.5 * atan2(across.y, across.x);
    for (var lobe = 0u; lobe < job.lobes; lobe++) {
        let at = unknown(lobe, 2u);
        let wide = clamp(vector[at] * cos(double) + vector[at + 1u] * sin(double), -0.3, 0.3);
        lobes[lobe] = vec4f(normalize(lobes[lobe].xyz + vec3f(wide, -wide, 0.0)), lobes[lobe].w);
    }
    beta = 0.5 * double;
    store(index);
}
