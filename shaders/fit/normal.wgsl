// Amplitudes and normal equations, as fit/separable/normal.rs.

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
