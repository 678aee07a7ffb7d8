//! A rig small enough to run dozens of times, and its runs.

use std::path::{Path, PathBuf};

use lobelia::acquire::recipe::Recipe;
use lobelia::acquire::{self, RunFolder, simulated};
use lobelia::plan::{self, Extent, Plan};
use lobelia::reflectance::Rgb;
use lobelia::rig::config::RigConfig;
use lobelia::{demo, develop, files};
use lobelia_hil_sim::optics::SampleLayout;

/// Sensor size relative to the default rig's.
const SCALE: f64 = 0.5;

/// A rig with a sensor of 400 × 300 pixels and `texels` across the sample; repeatability, backlash and lamp
/// drift are on, as by default.
pub fn rig(texels: usize) -> RigConfig {
    let mut rig = RigConfig::default();
    rig.carrier.texels_across = texels;
    let camera = &mut rig.camera;
    camera.width = (camera.width as f64 * SCALE) as usize;
    camera.height = (camera.height as f64 * SCALE) as usize;
    camera.focal_px = camera.focal_px.map(|f| f * SCALE);
    camera.principal_px = camera.principal_px.map(|c| (c + 0.5) * SCALE - 0.5);
    assert!(rig.simulator.repeatability && rig.simulator.lamp_drift > 0.0);
    assert!(rig.simulator.backlash_deg.iter().all(|&play| play > 0.0));
    rig
}

/// A plan of `poses` for the rig.
pub fn plan(rig: &RigConfig, poses: usize) -> Plan {
    plan::make(rig, Extent::Budget(poses), false, 1).expect("the rig reaches poses")
}

/// Writes `rig.toml` and `plan.toml` into a folder.
pub fn write_inputs(folder: &Path, rig: &RigConfig, plan: &Plan) {
    let text = toml::to_string(rig).expect("a rig can be written");
    files::write_bytes(&folder.join("rig.toml"), text.as_bytes()).expect("the disk takes rig.toml");
    plan.write(&folder.join("plan.toml")).expect("the disk takes plan.toml");
}

/// The demo's sample on the rig's carrier.
pub fn layout(rig: &RigConfig) -> SampleLayout {
    demo::sample::recipe().layout(Path::new("."), &rig.carrier).expect("the demo's recipe is right")
}

/// Runs a plan from its beginning to its end.
pub fn acquire(run: &Path, plan: &Plan, rig: &RigConfig, sample: SampleLayout) {
    let (run, mut journal) = RunFolder::create(run, plan, rig).expect("a new run can be laid out");
    let mut station = simulated::station(rig, sample).expect("the simulated rig answers");
    acquire::run(&run, &mut journal, &mut station).expect("the run succeeds");
}

/// Continues a run as another process would: with a rig that was switched off and on.
pub fn resume(run: &Path, sample: impl Fn(&RigConfig) -> SampleLayout) {
    let (run, mut journal) = RunFolder::resume(run).expect("the run can be resumed");
    let mut station = simulated::station(&run.rig, sample(&run.rig)).expect("the simulated rig answers");
    acquire::run(&run, &mut journal, &mut station).expect("the resumed run succeeds");
}

/// Develops a run into `sampled.zarr` in its folder; all poses must be registered.
pub fn develop(run: &Path) -> PathBuf {
    let developed = develop::run(run).expect("the run can be developed");
    assert!(developed.registrations.iter().all(Result::is_ok), "a pose was not registered");
    let store = run.join("sampled.zarr");
    developed.sampled.write_zarr(&store).expect("the disk takes the store");
    store
}

/// The recipe of a sample, as its file would be read.
pub fn recipe(text: &str) -> Recipe {
    toml::from_str(text).expect("the recipe is right")
}

/// The middle one of some numbers.
pub fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// |a − b| / |b| over the three channels.
pub fn relative_error(measured: Rgb, truth: Rgb) -> f64 {
    f64::from((measured - truth).length() / truth.length())
}

/// A generator of random numbers that is the same on every machine (splitmix64).
pub struct Random(pub u64);

impl Random {
    /// A number below `limit`.
    pub fn below(&mut self, limit: u64) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        (z ^ (z >> 31)) % limit
    }
}
