// The separable fit: Levenberg–Marquardt over the shapes of lobes, amplitudes in closed form; a workgroup a set of shapes.
// The twin in Rust is host/fit/src/fit/separable. The host joins the files of fit/ to this one and puts these constants before it:
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
