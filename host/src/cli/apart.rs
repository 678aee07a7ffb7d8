//! Whether a command would write over a file that it reads or over another of its outputs: what was measured
//! would be lost, and the command would seem to have succeeded.

use std::any::TypeId;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use clap::{ArgMatches, Command};

use crate::acquire::{PLAN_FILE, RIG_FILE, journal};
use crate::error::{Error, Result};
use crate::files;
use crate::mip;
use crate::scene::Mesh;

/// Arguments that name what is written, whatever the command.
const WRITTEN: [&str; 5] = ["output", "out", "report", "variance", "record"];

/// Commands whose output is a folder for files of names of their own.
const INTO_FOLDERS: [&str; 7] = ["acquire", "bake", "chart", "compare", "demo", "prefilter", "stability"];

/// More MIP levels than any map has.
const MOST_LEVELS: u32 = 16;

/// A file on the command line.
struct Named {
    /// As its user knows the argument: `--against`, `RIG`.
    argument: String,
    path: PathBuf,
}

/// What a command reads and what it writes.
#[derive(Default)]
struct Files {
    read: Vec<Named>,
    written: Vec<Named>,
    /// Folders that files are written into.
    folders: Vec<Named>,
    /// Whether the output may be what is read: `edit` reads all of it before it writes.
    in_place: bool,
}

/// Refuses a command line that names one file twice, to be written and for something else.
///
/// # Errors
/// An input error with the file and both arguments.
pub(super) fn check(command: &Command, matches: &ArgMatches) -> Result<()> {
    let files = files_of(command, matches);
    for (place, output) in files.written.iter().enumerate() {
        let may_be_read = files.in_place && output.argument == "--output";
        for input in files.read.iter().filter(|_| !may_be_read) {
            if would_write(&output.path, &input.path) {
                let (path, by) = (input.path.display(), &output.argument);
                return Err(refused(format!(
                    "{path}: read as {} and would be written over by {by}",
                    input.argument
                )));
            }
            if inside(&input.path).iter().any(|part| files::same(part, &output.path)) {
                return Err(refused(format!(
                    "{}: a part of {}, which is read; {} would write over it",
                    output.path.display(),
                    input.path.display(),
                    output.argument
                )));
            }
            if let Some(part) = made_of(&input.path).iter().find(|part| would_write(&output.path, part)) {
                return Err(refused(format!(
                    "{}: {} reads it and {} would write over it",
                    part.display(),
                    input.path.display(),
                    output.argument
                )));
            }
        }
        let others = files.written[..place].iter().chain(&files.folders);
        for other in others {
            let twice = would_write(&other.path, &output.path) || would_write(&output.path, &other.path);
            if twice || inside(&other.path).iter().any(|part| files::same(part, &output.path)) {
                let (path, by) = (output.path.display(), &output.argument);
                return Err(refused(format!("{path}: both {} and {by} would write it", other.argument)));
            }
        }
    }
    Ok(())
}

/// Whether what is written to `output` is `file`, or one of the pictures of an animation by that name with
/// a # is.
fn would_write(output: &Path, file: &Path) -> bool {
    let name = |path: &Path| path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let (pattern, of_file) = (name(output), name(file));
    let number = pattern
        .split_once('#')
        .and_then(|(begin, rest)| of_file.strip_prefix(begin)?.strip_suffix(rest.trim_start_matches('#')));
    let is_frame =
        number.is_some_and(|text| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit()));
    files::same(output, file) || (is_frame && files::same(&output.with_file_name(&of_file), file))
}

fn refused(message: String) -> Error {
    Error::input(message).hint("name another file")
}

/// The files that a command line names, those of subcommands included.
fn files_of(command: &Command, matches: &ArgMatches) -> Files {
    let mut files = Files::default();
    // Arguments of every command are found in each of its subcommands again.
    let mut arguments: BTreeMap<String, (bool, bool, Vec<Named>)> = BTreeMap::new();
    let (mut command, mut matches, mut first) = (command, matches, None);
    let mut levels = false;
    loop {
        levels |= matches.try_get_one::<bool>("mip").ok().flatten().copied().unwrap_or(false);
        let folder = INTO_FOLDERS.contains(&first.unwrap_or_default());
        for arg in command.get_arguments() {
            let id = arg.get_id().as_str();
            // The material of `synth` is a file or the name of one that is shipped.
            let is_path = arg.get_value_parser().type_id() == TypeId::of::<PathBuf>() || id == "material";
            let Some(values) = matches.try_get_raw(id).ok().flatten().filter(|_| is_path) else { continue };
            let argument = arg.get_long().map_or_else(|| id.to_uppercase(), |long| format!("--{long}"));
            let named =
                values.map(|value| Named { argument: argument.clone(), path: value.into() }).collect();
            let written = WRITTEN.contains(&id) || (id == "index" && command.get_name() == "cluster");
            let into_folder = folder && matches!(id, "output" | "out");
            arguments.insert(id.to_owned(), (written, into_folder, named));
        }
        let Some((name, below)) = matches.subcommand() else { break };
        let Some(found) = command.find_subcommand(name) else { break };
        first = first.or(Some(found.get_name()));
        (command, matches) = (found, below);
    }
    for (written, into_folder, named) in arguments.into_values() {
        match (written, into_folder) {
            (false, _) => files.read.extend(named),
            (true, false) => files.written.extend(named),
            (true, true) => files.folders.extend(named),
        }
    }
    let beside = |output: &Named| {
        let of = |level| Named { argument: "--mip".into(), path: mip::path(&output.path, level) };
        (1..=MOST_LEVELS).map(of).collect::<Vec<Named>>()
    };
    if levels && let Some(output) = files.written.iter().find(|named| named.argument == "--output") {
        files.written.extend(beside(output));
    }
    files.in_place = first == Some("edit");
    files
}

/// What may not be written of a folder that is a run, a store or a bake: the files by which it is one.
fn inside(folder: &Path) -> Vec<PathBuf> {
    let file = |name: &str| folder.join(name);
    if file(journal::FILE_NAME).is_file() {
        let frames = std::fs::read_dir(file("frames")).into_iter().flatten();
        let own = [journal::FILE_NAME, PLAN_FILE, RIG_FILE, "material.toml"].map(file);
        return own.into_iter().chain(frames.filter_map(|entry| Some(entry.ok()?.path()))).collect();
    }
    // Whoever writes to a store's parts names the group or an array of it.
    let parts = std::fs::read_dir(folder).into_iter().flatten().filter_map(|entry| Some(entry.ok()?.path()));
    if file("bake.json").is_file() {
        return parts.collect();
    }
    if file("zarr.json").is_file() {
        return parts.flat_map(|part| [part.join("zarr.json"), part]).collect();
    }
    Vec::new()
}

/// The files that a scene or a material names, and those that are read with them: a map's MIP levels, a glTF
/// document's buffers.
pub(super) fn made_of(path: &Path) -> Vec<PathBuf> {
    let beside = |named: &Path| match files::ending(named).as_str() {
        "exr" => (1..).map(|level| mip::path(named, level)).take_while(|file| file.is_file()).collect(),
        "gltf" => Mesh::gltf_buffers(named),
        _ => Vec::new(),
    };
    in_toml(path).into_iter().flat_map(|named| std::iter::once(named.clone()).chain(beside(&named))).collect()
}

/// The files that a TOML file, a scene or a material, names beside it.
fn in_toml(path: &Path) -> Vec<PathBuf> {
    fn strings(value: &toml::Value, found: &mut Vec<String>) {
        match value {
            toml::Value::String(text) => found.push(text.clone()),
            toml::Value::Array(items) => items.iter().for_each(|item| strings(item, found)),
            toml::Value::Table(table) => table.iter().for_each(|(_, item)| strings(item, found)),
            _ => {}
        }
    }
    if files::ending(path) != "toml" {
        return Vec::new();
    }
    let table: Option<toml::Table> = std::fs::read_to_string(path).ok().and_then(|text| text.parse().ok());
    let mut found = Vec::new();
    table.into_iter().for_each(|table| strings(&toml::Value::Table(table), &mut found));
    let folder = path.parent().unwrap_or(Path::new(""));
    found.iter().map(|name| folder.join(name)).filter(|file| file.is_file()).collect()
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;
    use crate::cli::Cli;

    /// What is said of a command line in a folder, whose files are named by `DIR/`.
    fn said(folder: &Path, line: &str) -> Option<String> {
        let line = line.replace("DIR", &folder.display().to_string());
        let command = Cli::command();
        let matches = command.clone().try_get_matches_from(format!("lobelia {line}").split(' ')).unwrap();
        check(&command, &matches).err().map(|error| {
            assert_eq!(error.exit_code(), 2);
            error.to_string()
        })
    }

    fn folder() -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        let scene = "[[object]]\nmaterial = { map = \"m.exr\" }\n";
        for (name, text) in [
            ("rig.toml", "x"),
            ("plan.toml", "x"),
            ("m.exr", "x"),
            ("n-16.exr", "x"),
            ("scene.toml", scene),
            ("run/journal.jsonl", "{}\n"),
            ("run/frames/pose-00000-0.tiff", "x"),
            ("s.zarr/zarr.json", "{}"),
            ("s.zarr/reflectance/zarr.json", "{}"),
        ] {
            files::write_bytes(&folder.path().join(name), text.as_bytes()).unwrap();
        }
        folder
    }

    /// Each of these would destroy what it names twice.
    #[test]
    fn what_is_read_is_not_written_over_and_no_output_is_another() {
        let folder = folder();
        std::fs::hard_link(folder.path().join("m.exr"), folder.path().join("linked.exr")).unwrap();
        for line in [
            "plan DIR/rig.toml --budget 4 -o DIR/rig.toml",
            "plan DIR/rig.toml --budget 4 --report DIR/rig.toml -o DIR/new.toml",
            "plan DIR/rig.toml --budget 4 -o DIR/run/../rig.toml",
            "develop DIR/run --report DIR/run/journal.jsonl",
            "develop DIR/run --report DIR/run/frames/pose-00000-0.tiff",
            "develop DIR/run -o DIR/new.zarr --rig DIR/rig.toml --report DIR/rig.toml",
            "acquire DIR/plan.toml --rig DIR/rig.toml --port sim --camera sim -o DIR/new --record \
             DIR/plan.toml",
            "acquire --resume --port sim --camera sim -o DIR/run --report DIR/run/journal.jsonl",
            "render lamps -o DIR/m.exr --against DIR/m.exr",
            "render lamps -o DIR/linked.exr --against DIR/m.exr",
            "render DIR/scene.toml -o DIR/m.exr",
            "render lamps -o DIR/v.exr --variance DIR/v.exr",
            "render lamps -o DIR/a.exr --report DIR/a.exr",
            "render lamps -o DIR/a.png -o DIR/a.png",
            "fit --merge DIR/m.exr DIR/n-16.exr -o DIR/m.exr",
            "fit DIR/s.zarr -o DIR/new.exr --report DIR/s.zarr/zarr.json",
            "fit DIR/s.zarr -o DIR/new.exr --report DIR/s.zarr/reflectance/zarr.json",
            "fit DIR/s.zarr -o DIR/new.exr --mip --report DIR/new.mip2.exr",
            "fit DIR/s.zarr -o DIR/new.exr --mip --merge DIR/a.exr DIR/new.mip1.exr",
            "render DIR/scene.toml -o DIR/n-##.exr --against DIR/n-16.exr",
            "render lamps -o DIR/a##.png --report DIR/a02.png",
            "edit tile DIR/m.exr -o DIR/new.exr --report DIR/m.exr",
            "edit cluster DIR/m.exr -o DIR/p.toml --index DIR/p.toml",
            "rig replay DIR/plan.toml --port sim --report DIR/plan.toml",
        ] {
            let said = said(folder.path(), line).unwrap_or_else(|| panic!("nothing is said of {line}"));
            assert!(said.ends_with("; name another file"), "{said}");
        }
    }

    #[test]
    fn files_that_are_named_once_are_written_and_an_edit_may_take_its_own_place() {
        let folder = folder();
        for line in [
            "plan DIR/rig.toml --budget 4 -o DIR/plan.toml",
            "develop DIR/run -o DIR/run/sampled.zarr --report DIR/run/develop.json",
            "acquire DIR/plan.toml --rig DIR/rig.toml --port sim --camera sim -o DIR/run2 --report \
             DIR/a.json",
            "render DIR/scene.toml -o DIR/a.exr -o DIR/a.png --variance DIR/v.exr --against DIR/m.exr",
            "render lamps -o /dev/null --report /dev/null",
            "render lamps -o DIR/a##.png --report DIR/a.json",
            "render lamps -o DIR/a##.png --report DIR/a0x.png",
            "fit DIR/s.zarr -o DIR/new.exr --report DIR/new.mip2.json",
            "edit tile DIR/m.exr -o DIR/m.exr",
            "edit palette DIR/plan.toml --index DIR/p.png -o DIR/m.exr",
            "compare DIR/run DIR/m.exr -o DIR/run",
            "prefilter sky -n 16 -o sky",
            "fit DIR/s.zarr -o DIR/m.exr",
        ] {
            assert_eq!(said(folder.path(), line), None, "{line}");
        }
    }
}
