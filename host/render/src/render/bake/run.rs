//! Baking into folders: what is left to do, in chunks for several machines, and their joining.

use std::path::{Path, PathBuf};
use std::time::Instant;

use super::folder::{Folder, HEAD, Logged, difference};
use super::{Bake, Baked, Made, Part, part_file};
use crate::render::Renderer;
use crate::scene::Scene;
use lobelia_base::error::{Error, Result};
use lobelia_base::progress;
use lobelia_fit::fit::chunks::Part as Chunk;

/// Steps of the bar that shows progress.
const STEPS: f64 = 1000.0;

/// Where to bake, and how much of it.
#[derive(Debug, Clone, Copy)]
pub struct Task<'a> {
    /// The folder.
    pub folder: &'a Path,
    /// Chunk i of n takes every n-th part from the i-th on.
    pub chunk: Option<Chunk>,
    /// Whether to stop after the part that tells what the others take.
    pub estimate_only: bool,
}

/// What is left to bake, foretold.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// Parts.
    pub parts: usize,
    /// Seconds.
    pub seconds: f64,
    /// Bytes on disk.
    pub bytes: u64,
}

/// What came of baking.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Outcome {
    /// Parts made now, parts that were there, and all.
    pub parts: [usize; 3],
    /// Parts of this task that need others that are not there yet.
    pub waiting: usize,
    /// Parts of this task that are left.
    pub left: usize,
    /// Seconds now.
    pub seconds: f64,
    /// Rays now.
    pub rays: u64,
    /// Bytes written now.
    pub bytes: u64,
    /// Parts that were found damaged and made again.
    pub damaged: usize,
}

/// Bakes a scene into a folder, going on where an earlier run was killed. `tell` hears what it will take,
/// after the least part.
///
/// # Errors
/// Input errors for a method that bakes nothing and for a folder of something else; those of the method and
/// of the disk.
pub fn bake(
    renderer: &dyn Renderer,
    scene: &Scene,
    task: Task<'_>,
    tell: impl FnOnce(&Estimate),
) -> Result<Outcome> {
    scene.check()?;
    let Some(made_of) = renderer.made_of(scene)? else {
        return Err(Error::input(format!("`{}` bakes nothing; render with it at once", renderer.name())));
    };
    if task.folder.join("bake.json").exists() {
        // Refused before the work, and done at once where there is none.
        Folder::open(task.folder)?.must_be(&made_of).map_err(|error| error.hint("or name another folder"))?;
    }
    let start = Instant::now();
    let work = renderer
        .bake(scene)?
        .ok_or_else(|| Error::failure(format!("`{}` bakes nothing of this scene", renderer.name())))?;
    let parts = work.parts();
    if let Some(chunk) = task.chunk.filter(|chunk| chunk.count > parts.len()) {
        let all = progress::counted(parts.len() as u64, "part", "parts");
        return Err(Error::input(format!(
            "{} chunks were asked for; there is {all}, of which each takes at least one",
            chunk.count
        )));
    }
    let folder = Folder::create(task.folder, &made_of, parts.len())?;
    run(work.as_ref(), &parts, &folder, task, start, tell)
}

fn run(
    work: &dyn Bake,
    parts: &[Part],
    folder: &Folder,
    task: Task<'_>,
    start: Instant,
    tell: impl FnOnce(&Estimate),
) -> Result<Outcome> {
    let is_own = |index: &usize| task.chunk.is_none_or(|chunk| index % chunk.count == chunk.index - 1);
    let mut outcome = Outcome { parts: [0, 0, parts.len()], ..Outcome::default() };
    // What is there is read: damage must not stay.
    let mut there = vec![false; parts.len()];
    let mut left = Vec::new();
    for (index, there) in there.iter_mut().enumerate() {
        let exists = part_file(&folder.path, index).exists();
        let own = is_own(&index);
        *there = exists
            && match own {
                true => folder.content(index).is_ok(),
                false => matches!(folder.head(index), Ok(Some(_))),
            };
        match (own, *there) {
            (true, true) => outcome.parts[1] += 1,
            (true, false) => {
                outcome.damaged += usize::from(exists);
                left.push(index);
            }
            (false, _) => {}
        }
    }
    let done_before = Baked::of_parts_in(folder.clone());
    // Time for what all parts share counts for the first that is made.
    let mut begun = start;
    let mut make = |index: usize, there: &mut Vec<bool>, outcome: &mut Outcome| -> Result<f64> {
        let made: Made = work.part(index, &done_before)?;
        folder.write(index, &made)?;
        let seconds = begun.elapsed().as_secs_f64();
        folder.log(&[Logged { part: index, seconds }])?;
        begun = Instant::now();
        there[index] = true;
        outcome.parts[0] += 1;
        outcome.rays += made.rays;
        outcome.bytes += (HEAD + made.content.len()) as u64;
        Ok(seconds)
    };
    let ready = |index: usize, there: &[bool]| parts[index].needs.clone().all(|needed| there[needed]);
    let shared = start.elapsed().as_secs_f64();
    // The least part tells what the others will take.
    let least = left.iter().copied().filter(|index| ready(*index, &there));
    let least = least.min_by(|a, b| parts[*a].work.total_cmp(&parts[*b].work));
    let whole: f64 = left.iter().map(|index| parts[*index].work).sum();
    let mut done = 0.0;
    if let Some(least) = least {
        let own = make(least, &mut there, &mut outcome)? - shared;
        let each = own.max(0.0) / parts[least].work.max(f64::MIN_POSITIVE);
        let bytes = left.iter().map(|index| HEAD as u64 + parts[*index].bytes).sum();
        tell(&Estimate { parts: left.len(), seconds: shared + each * whole, bytes });
        done = parts[least].work;
        left.retain(|index| *index != least);
    }
    if !task.estimate_only {
        let bar = progress::bar("baking", STEPS as u64, "‰");
        let mut shown = 0;
        let mut show = |done: f64| {
            let now = (STEPS * done / whole.max(f64::MIN_POSITIVE)) as u64;
            bar.advance(now - shown);
            shown = now;
        };
        show(done);
        for index in std::mem::take(&mut left) {
            if !ready(index, &there) {
                left.push(index);
                continue;
            }
            make(index, &mut there, &mut outcome)?;
            done += parts[index].work;
            show(done);
        }
        outcome.waiting = left.len();
    }
    outcome.left = left.len();
    outcome.seconds = start.elapsed().as_secs_f64();
    Ok(outcome)
}

/// Joins what was baked in chunks into one folder, which may be one of them; returns how many parts it has
/// and how many there are.
///
/// # Errors
/// Input errors for folders that are not of the same, for damaged parts and for parts that none of them has.
pub fn merge(chunks: &[PathBuf], into: &Path) -> Result<Baked> {
    let folders = chunks.iter().map(|path| Folder::open(path)).collect::<Result<Vec<_>>>()?;
    let Some(first) = folders.first() else {
        return Err(Error::input("no folder was named"));
    };
    for other in &folders {
        if let Some(difference) = difference(&other.made_of, &first.made_of) {
            return Err(Error::input(format!(
                "{} does not belong to {}: it was baked {difference}",
                other.path.display(),
                first.path.display()
            )));
        }
        if other.parts != first.parts {
            return Err(other.damaged("bake.json"));
        }
    }
    let target = Folder::create(into, &first.made_of, first.parts)?;
    let bar = progress::bar("joining", first.parts as u64, "parts");
    let mut missing = Vec::new();
    let seconds: Vec<_> = folders.iter().map(Folder::logged).collect();
    let known = target.logged();
    for index in 0..first.parts {
        bar.advance(1);
        if part_file(into, index).exists() && target.content(index).is_ok() {
            continue;
        }
        let source = folders.iter().zip(&seconds).find(|(folder, _)| part_file(&folder.path, index).exists());
        let Some((folder, seconds)) = source else {
            missing.push(index);
            continue;
        };
        let content = folder.content(index)?;
        let rays = folder.head(index)?.map_or(0, |head| head.rays);
        target.write(index, &Made { content, rays })?;
        if let Some(&seconds) = seconds.get(&index).filter(|_| !known.contains_key(&index)) {
            target.log(&[Logged { part: index, seconds }])?;
        }
    }
    if !missing.is_empty() {
        let (named, into) = (named(&missing), into.display());
        return Err(Error::input(format!(
            "{into}: not all parts are there; missing: {named} of {}; bake their chunks and merge again",
            first.parts
        )));
    }
    Baked::of(target)
}

/// Parts by their numbers, a few of them.
pub(super) fn named(parts: &[usize]) -> String {
    const SHOWN: usize = 8;
    let numbers: Vec<String> = parts.iter().take(SHOWN).map(ToString::to_string).collect();
    let more = if parts.len() > SHOWN { format!(" and {} more", parts.len() - SHOWN) } else { String::new() };
    format!("{}{more}", numbers.join(", "))
}
