// The separable fit: Levenberg–Marquardt over the shapes of lobes, amplitudes in closed form; a workgroup a set of shapes.
// The twin in Rust is host/src/fit/separable. The host puts these constants before this text:
//   LOBES; SLOTS, at least 1; FAMILY; DERIVATIVES a lobe; FORMS, at least 1; UNKNOWNS of the shapes, at least 1; MOST, the larger of UNKNOWNS and LOBES + 1.
//
// Sums are of f32. Two things keep them right: a tile's products are summed before they are added to the total, and the products with the
// samples are those with the residuals of the model that was accepted last, so that the fall in cost is no difference of large numbers.

const GROUP = 32u;
const ISOTROPIC = 0u;
const ANISOTROPIC = 1u;
const SPLIT = 2u;

// Columns: root of the weight, shapes; derivatives lobe by lobe; residuals of three channels.
const LINEAR = LOBES + 1u;
const RESIDUAL = LINEAR + LOBES * DERIVATIVES;
const COLUMNS = RESIDUAL + 3u;
// Their products: the lower triangle, row by row.
const ENTRIES = COLUMNS * (COLUMNS + 1u) / 2u;
const ROUNDS = (ENTRIES + GROUP - 1u) / GROUP;

const LEAST_REFERENCE = 1e-3;
const LEAST_EXPONENT = 0.5;
const MOST_EXPONENT = 5000.0;
const NEGLIGIBLE = -40.0;
const TAU = 6.28318531;
const ROOT_HALF = 0.70710678;
// No set of bounds has a value as large as this.
const REFUSED = 1e30;

struct Job {
    // Places a texel in the lists of samples.
    poses: u32,
    channels: u32,
    // 1 where rho_d is an unknown.
    diffuse: u32,
    iterations: u32,
    tolerance: f32,
    // LOBES and UNKNOWNS once more: loops over these two are not unrolled, which would make the shader slow to compile.
    lobes: u32,
    unknowns: u32,
    // First set of this dispatch.
    first: u32,
}

struct Texel {
    // Largest amplitude a channel; the sum of the squared goals.
    most: vec4f,
    // Largest theta_i and theta_o.
    cone: vec4f,
}

struct Fit {
    texel: u32,
    beta: f32,
    cost: f32,
    unused: u32,
    // C and n.
    lobes: array<vec4f, 4>,
    // rho_d and amplitudes, three channels each.
    x: array<vec4f, 5>,
}

@group(0) @binding(0) var<uniform> job: Job;
// xx, yy, zz, xy of a texel's samples, texel by texel.
@group(0) @binding(1) var<storage, read> products: array<vec4f>;
// Root of the weight, goals.
@group(0) @binding(2) var<storage, read> aimed: array<vec4f>;
@group(0) @binding(3) var<storage, read> texels: array<Texel>;
@group(0) @binding(4) var<storage, read_write> fits: array<Fit>;
// [set][direction][exponent]
@group(0) @binding(5) var<storage, read_write> scores: array<f32>;

var<workgroup> most: array<f32, 3>;
var<workgroup> whole: f32;
var<workgroup> cone: vec2f;

// The model that was accepted last, and the one that is tried.
var<workgroup> beta: f32;
var<workgroup> lobes: array<vec4f, SLOTS>;
var<workgroup> x: array<f32, 3u * LINEAR>;
var<workgroup> trial_beta: f32;
var<workgroup> trial_lobes: array<vec4f, SLOTS>;
var<workgroup> trial_x: array<f32, 3u * LINEAR>;
// A bit an unknown that is at no bound.
var<workgroup> trial_free: array<u32, 3>;

// Base and tangents of the trial's lobes as linear forms in the products.
var<workgroup> forms: array<vec4f, SLOTS * FORMS>;
// [sample][column]
var<workgroup> tile: array<f32, GROUP * COLUMNS>;
var<workgroup> gram: array<f32, ENTRIES>;

// Normal equations of the shapes at the accepted model.
var<workgroup> normal: array<f32, UNKNOWNS * UNKNOWNS>;
var<workgroup> gradient: array<f32, UNKNOWNS>;
// A small system and its right side.
var<workgroup> matrix: array<f32, MOST * MOST>;
var<workgroup> vector: array<f32, MOST>;
// The derivatives' parts along the free columns.
var<workgroup> inner: array<f32, SLOTS * FORMS * LINEAR>;
var<workgroup> running: u32;

// Of the first invocation.
var<private> cost: f32;
var<private> damping: f32;
var<private> growth: f32;
var<private> predicted: f32;

// ---- small systems, as fit/linear.rs ----

fn factor(size: u32) -> bool {
    for (var i = 0u; i < size; i++) {
        for (var j = 0u; j <= i; j++) {
            var rest = matrix[i * size + j];
            for (var k = 0u; k < j; k++) {
                rest -= matrix[i * size + k] * matrix[j * size + k];
            }
            if i == j {
                if !(rest > 0.0) {
                    return false;
                }
                matrix[i * size + i] = sqrt(rest);
            } else {
                matrix[i * size + j] = rest / matrix[j * size + j];
            }
        }
    }
    return true;
}

fn substitute(size: u32) {
    for (var i = 0u; i < size; i++) {
        var rest = vector[i];
        for (var k = 0u; k < i; k++) {
            rest -= matrix[i * size + k] * vector[k];
        }
        vector[i] = rest / matrix[i * size + i];
    }
    for (var back = 0u; back < size; back++) {
        let i = size - 1u - back;
        var rest = vector[i];
        for (var k = i + 1u; k < size; k++) {
            rest -= matrix[k * size + i] * vector[k];
        }
        vector[i] = rest / matrix[i * size + i];
    }
}

// ---- shapes, as fit/model.rs and fit/separable/shape.rs ----

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

// ---- columns and their products, as fit/separable/columns.rs ----

// The columns of a tile's sample, one an invocation.
fn fill(texel: u32, start: u32, lane: u32) {
    let row = lane * COLUMNS;
    let pose = start + lane;
    var p = vec4f(0.0);
    var sample = vec4f(0.0);
    if pose < job.poses {
        p = products[texel * job.poses + pose];
        sample = aimed[texel * job.poses + pose];
    }
    let root = sample.x;
    var rest = sample.yzw - vec3f(x[0], x[LINEAR], x[2u * LINEAR]) * root;
    tile[row] = root;
    for (var lobe = 0u; lobe < LOBES; lobe++) {
        let n = trial_lobes[lobe].w;
        let base = max(dot(forms[lobe * FORMS], p), 1e-30);
        let power = clamp(n * log(base), NEGLIGIBLE, -NEGLIGIBLE);
        let value = select(0.0, root * exp(power), power > NEGLIGIBLE);
        tile[row + 1u + lobe] = value;
        rest -= vec3f(x[1u + lobe], x[LINEAR + 1u + lobe], x[2u * LINEAR + 1u + lobe]) * value;
        if DERIVATIVES > 0u {
            let at = row + LINEAR + lobe * DERIVATIVES;
            let slope = value * n / base;
            tile[at] = value * power;
            for (var k = 1u; k < DERIVATIVES; k++) {
                tile[at + k] = dot(forms[lobe * FORMS + k], p) * slope;
            }
        }
    }
    for (var channel = 0u; channel < 3u; channel++) {
        tile[row + RESIDUAL + channel] = rest[channel];
    }
}

// Row and column of an entry of the lower triangle.
fn place(entry: u32) -> vec2u {
    var row = 0u;
    while (row + 1u) * (row + 2u) / 2u <= entry {
        row++;
    }
    return vec2u(row, entry - row * (row + 1u) / 2u);
}

fn add_products(lane: u32, sums: ptr<function, array<f32, ROUNDS>>) {
    for (var round = 0u; round < ROUNDS; round++) {
        let entry = round * GROUP + lane;
        if entry < ENTRIES {
            let at = place(entry);
            var sum = 0.0;
            for (var k = 0u; k < GROUP; k++) {
                sum += tile[k * COLUMNS + at.x] * tile[k * COLUMNS + at.y];
            }
            (*sums)[round] += sum;
        }
    }
}

fn keep_products(lane: u32, sums: ptr<function, array<f32, ROUNDS>>) {
    for (var round = 0u; round < ROUNDS; round++) {
        let entry = round * GROUP + lane;
        if entry < ENTRIES {
            gram[entry] = (*sums)[round];
        }
    }
}

// The products of the trial's columns.
fn make_gram(texel: u32, lane: u32) {
    workgroupBarrier();
    var sums: array<f32, ROUNDS>;
    for (var start = 0u; start < job.poses; start += GROUP) {
        fill(texel, start, lane);
        workgroupBarrier();
        add_products(lane, &sums);
        workgroupBarrier();
    }
    keep_products(lane, &sums);
    workgroupBarrier();
}

fn product(a: u32, b: u32) -> f32 {
    let row = max(a, b);
    return gram[row * (row + 1u) / 2u + min(a, b)];
}

// ---- amplitudes and normal equations, as fit/separable/normal.rs ----

// The change of a channel's cost when the unknowns of `free` are solved for, those of `held` are at their largest and the others 0; leaves
// the change of the amplitudes in `vector`. REFUSED where that passes a bound.
fn with_free(channel: u32, free: u32, held: u32) -> f32 {
    var change: array<f32, LINEAR>;
    var members: array<u32, LINEAR>;
    var count = 0u;
    for (var i = 0u; i <= job.lobes; i++) {
        if (free >> i & 1u) == 1u {
            members[count] = i;
            count++;
        } else {
            change[i] = select(0.0, most[channel], (held >> i & 1u) == 1u) - x[channel * LINEAR + i];
        }
    }
    for (var a = 0u; a < count; a++) {
        let i = members[a];
        var right = product(i, RESIDUAL + channel);
        for (var j = 0u; j <= job.lobes; j++) {
            right -= product(i, j) * change[j];
        }
        vector[a] = right;
        for (var b = 0u; b < count; b++) {
            matrix[a * count + b] = product(i, members[b]) * select(1.0, 1.0 + 1e-6, a == b);
        }
    }
    if !factor(count) {
        return REFUSED;
    }
    substitute(count);
    for (var a = 0u; a < count; a++) {
        change[members[a]] = vector[a];
        if x[channel * LINEAR + members[a]] + vector[a] < 0.0 {
            return REFUSED;
        }
    }
    var value = 0.0;
    for (var i = 0u; i <= job.lobes; i++) {
        var along = -2.0 * product(i, RESIDUAL + channel);
        for (var j = 0u; j <= job.lobes; j++) {
            along += product(i, j) * change[j];
        }
        value += change[i] * along;
    }
    for (var i = 0u; i <= job.lobes; i++) {
        vector[i] = change[i];
    }
    return value;
}

// The channel's amplitudes within their bounds; returns its cost.
fn solve_channel(channel: u32) -> f32 {
    let all = ((1u << LINEAR) - 1u) & ~(1u - job.diffuse);
    let goal = RESIDUAL + channel;
    var held = 0u;
    var best = REFUSED;
    for (var round = 0u; round <= job.lobes; round++) {
        let candidates = all & ~held;
        var free = candidates;
        best = REFUSED;
        loop {
            let value = with_free(channel, free, held);
            if value < best {
                best = value;
                trial_free[channel] = free;
                for (var i = 0u; i <= job.lobes; i++) {
                    trial_x[channel * LINEAR + i] = x[channel * LINEAR + i] + vector[i];
                }
            }
            // Where all may be free no subset does better.
            if free == 0u || (free == candidates && value < REFUSED) {
                break;
            }
            free = (free - 1u) & candidates;
        }
        var worst = 0u;
        var over = 0.0;
        for (var i = 1u; i <= job.lobes; i++) {
            let beyond = trial_x[channel * LINEAR + i] - most[channel];
            if (held >> i & 1u) == 0u && beyond > over {
                worst = i;
                over = beyond;
            }
        }
        if worst == 0u {
            break;
        }
        held |= 1u << worst;
    }
    return max(product(goal, goal) + best, 0.0);
}

fn solve_amplitudes() -> f32 {
    var sum = 0.0;
    for (var channel = 0u; channel < job.channels; channel++) {
        sum += solve_channel(channel);
    }
    return sum;
}

// Adds the products of the derivatives, without what the free columns span, of the channels with these free amplitudes.
fn add_projected(free: u32) {
    var members: array<u32, LINEAR>;
    var count = 0u;
    for (var i = 0u; i <= job.lobes; i++) {
        if (free >> i & 1u) == 1u {
            members[count] = i;
            count++;
        }
    }
    for (var a = 0u; a < count; a++) {
        for (var b = 0u; b < count; b++) {
            matrix[a * count + b] = product(members[a], members[b]) * select(1.0, 1.0 + 1e-6, a == b);
        }
    }
    if !factor(count) {
        count = 0u;
    }
    for (var d = 0u; d < job.lobes * DERIVATIVES; d++) {
        for (var a = 0u; a < count; a++) {
            var rest = product(members[a], LINEAR + d);
            for (var k = 0u; k < a; k++) {
                rest -= matrix[a * count + k] * inner[d * LINEAR + k];
            }
            inner[d * LINEAR + a] = rest / matrix[a * count + a];
        }
    }
    for (var d = 0u; d < job.lobes * DERIVATIVES; d++) {
        let lobe = d / FORMS;
        let row = unknown(lobe, d % FORMS) * UNKNOWNS;
        for (var e = 0u; e < job.lobes * DERIVATIVES; e++) {
            let other = e / FORMS;
            var weight = 0.0;
            for (var channel = 0u; channel < job.channels; channel++) {
                if trial_free[channel] == free {
                    weight += trial_x[channel * LINEAR + 1u + lobe] * trial_x[channel * LINEAR + 1u + other];
                }
            }
            var rest = product(LINEAR + d, LINEAR + e);
            for (var k = 0u; k < count; k++) {
                rest -= inner[d * LINEAR + k] * inner[e * LINEAR + k];
            }
            normal[row + unknown(other, e % FORMS)] += weight * rest;
        }
    }
}

// The normal equations at the trial; the residuals in the products are still those with the amplitudes of the accepted model.
fn set_normal() {
    for (var i = 0u; i < job.unknowns * job.unknowns; i++) {
        normal[i] = 0.0;
    }
    for (var i = 0u; i < job.unknowns; i++) {
        gradient[i] = 0.0;
    }
    for (var channel = 0u; channel < job.channels; channel++) {
        var seen = false;
        for (var other = 0u; other < channel; other++) {
            seen = seen || trial_free[other] == trial_free[channel];
        }
        if !seen {
            add_projected(trial_free[channel]);
        }
    }
    for (var d = 0u; d < job.lobes * DERIVATIVES; d++) {
        let lobe = d / FORMS;
        var sum = 0.0;
        for (var channel = 0u; channel < job.channels; channel++) {
            let first = channel * LINEAR;
            var residual = -product(LINEAR + d, RESIDUAL + channel);
            for (var i = 0u; i <= job.lobes; i++) {
                residual += product(LINEAR + d, i) * (trial_x[first + i] - x[first + i]);
            }
            sum += trial_x[first + 1u + lobe] * residual;
        }
        gradient[unknown(lobe, d % FORMS)] += sum;
    }
}

// The damped step in `vector`; false where the equations are singular.
fn solve_step() -> bool {
    var fixed = 0u;
    var largest = 0.0;
    for (var i = 0u; i < job.unknowns; i++) {
        largest = max(largest, normal[i * UNKNOWNS + i]);
    }
    for (var lobe = 0u; lobe < job.lobes; lobe++) {
        let at = unknown(lobe, 0u);
        let n = lobes[lobe].w;
        if (n <= LEAST_EXPONENT && gradient[at] > 0.0) || (n >= MOST_EXPONENT && gradient[at] < 0.0) {
            fixed |= 1u << at;
        }
    }
    for (var i = 0u; i < job.unknowns; i++) {
        if normal[i * UNKNOWNS + i] <= 1e-9 * largest {
            fixed |= 1u << i;
        }
    }
    for (var i = 0u; i < job.unknowns; i++) {
        let still = (fixed >> i & 1u) == 1u;
        for (var j = 0u; j < job.unknowns; j++) {
            let other = (fixed >> j & 1u) == 1u;
            matrix[i * UNKNOWNS + j] = select(normal[i * UNKNOWNS + j], 0.0, still || other);
        }
        matrix[i * UNKNOWNS + i] = select(normal[i * UNKNOWNS + i] * (1.0 + damping), 1.0, still);
        vector[i] = select(-gradient[i], 0.0, still);
    }
    if !factor(job.unknowns) {
        return false;
    }
    substitute(job.unknowns);
    return true;
}

// The fall in cost that the linear model promises for the step.
fn promised() -> f32 {
    var gain = 0.0;
    for (var i = 0u; i < job.unknowns; i++) {
        var along = 2.0 * gradient[i];
        for (var j = 0u; j < job.unknowns; j++) {
            along += normal[i * UNKNOWNS + j] * vector[j];
        }
        gain -= vector[i] * along;
    }
    return gain;
}

// ---- the solver, as fit/separable/solver.rs ----

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

// ---- starts, as fit/separable/start.rs ----

const DIRECTIONS = 24u;
const EXPONENTS = 10u;
// The exponents and the square of the last.
const ROWS = EXPONENTS + 1u;
// Weighted residual, weight, weighted shapes.
const LISTS = LOBES + 2u;

// Adds a tile's products of a direction's shapes with the lists.
fn add_bank(texel: u32, start: u32, form: vec3f, sums: ptr<function, array<f32, ROWS * LISTS>>) {
    for (var k = 0u; k < min(GROUP, job.poses - start); k++) {
        let p = products[texel * job.poses + start + k];
        let row = k * COLUMNS;
        let root = tile[row];
        let rest = tile[row + RESIDUAL] + tile[row + RESIDUAL + 1u] + tile[row + RESIDUAL + 2u];
        var shape = clamp(form.x * p.x + form.y * p.y + form.z * p.z, 0.0, 4.0);
        for (var exponent = 0u; exponent < ROWS; exponent++) {
            let weighted = shape * root;
            (*sums)[exponent * LISTS] += weighted * rest;
            (*sums)[exponent * LISTS + 1u] += weighted * root;
            for (var lobe = 0u; lobe < LOBES; lobe++) {
                (*sums)[exponent * LISTS + 2u + lobe] += weighted * tile[row + 1u + lobe];
            }
            shape = select(min(shape * shape, 1e9), 0.0, shape < 1e-15);
        }
    }
}

var<workgroup> chosen: array<u32, LINEAR>;
var<workgroup> known: u32;

// The columns that have an amplitude, and the factor of their products.
fn choose_known() {
    var count = 0u;
    for (var i = 0u; i <= job.lobes; i++) {
        if max(x[i], max(x[LINEAR + i], x[2u * LINEAR + i])) > 0.0 {
            chosen[count] = i;
            count++;
        }
    }
    for (var a = 0u; a < count; a++) {
        for (var b = 0u; b < count; b++) {
            matrix[a * count + b] = product(chosen[a], chosen[b]) * select(1.0, 1.0 + 1e-6, a == b);
        }
    }
    if !factor(count) {
        count = 0u;
    }
    known = count;
}

// How much each shape of the bank would lower the cost beside those of the set, to first order; -REFUSED where it adds nothing.
@compute @workgroup_size(32)
fn score(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) lane: u32) {
    let index = job.first + group.x;
    let texel = fits[index].texel;
    if lane == 0u {
        load(index);
    }
    workgroupBarrier();
    let c = isotropic_c((f32(lane) + 0.5) / f32(DIRECTIONS) * TAU);
    let form = c / reference(c);
    var sums: array<f32, ROUNDS>;
    var bank: array<f32, ROWS * LISTS>;
    for (var start = 0u; start < job.poses; start += GROUP) {
        fill(texel, start, lane);
        workgroupBarrier();
        add_products(lane, &sums);
        add_bank(texel, start, form, &bank);
        workgroupBarrier();
    }
    keep_products(lane, &sums);
    workgroupBarrier();
    if lane == 0u {
        choose_known();
    }
    workgroupBarrier();
    if lane >= DIRECTIONS {
        return;
    }
    for (var exponent = 0u; exponent < EXPONENTS; exponent++) {
        let row = exponent * LISTS;
        let square = bank[row + LISTS + 1u];
        var rest = square;
        var along: array<f32, LINEAR>;
        for (var a = 0u; a < known; a++) {
            var value = bank[row + 1u + chosen[a]];
            for (var k = 0u; k < a; k++) {
                value -= matrix[a * known + k] * along[k];
            }
            along[a] = value / matrix[a * known + a];
            rest -= along[a] * along[a];
        }
        let gain = bank[row];
        let useful = gain > 0.0 && square > 0.0;
        let value = select(-REFUSED, gain * gain / max(rest, 1e-4 * square), useful);
        scores[(index * DIRECTIONS + lane) * EXPONENTS + exponent] = value;
    }
}
