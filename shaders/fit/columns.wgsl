// Columns and their products, as fit/separable/columns.rs.

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
