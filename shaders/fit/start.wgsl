// Starts, as fit/separable/start.rs.

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
