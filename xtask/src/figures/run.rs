//! Runs the commands of the registry, each in a folder of its own under target/figures, once.

use std::collections::BTreeMap;
use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Instant;

use anyhow::{Context, Result, bail};
use serde_json::json;

use super::lookup::Output;
use super::registry::{Recipe, Registry};
use super::tested;

/// Where and with what commands run.
pub(super) struct Runner<'a> {
    pub(super) registry: &'a Registry,
    /// The repository.
    pub(super) root: &'a Path,
    /// The folder of the commands' folders.
    pub(super) folder: PathBuf,
    /// The `lobelia` program.
    pub(super) program: PathBuf,
    /// Whether output that is there is taken as it is.
    pub(super) reuse: bool,
}

/// The file by which a folder's output is known to be complete.
const STEPS: &str = "steps.json";

impl Runner<'_> {
    /// The folder of a command.
    pub(super) fn folder_of(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    /// Runs a command and those that it needs, unless that has been done; `done` has how each went.
    pub(super) fn run(
        &self,
        name: &str,
        done: &mut BTreeMap<String, Result<(), String>>,
    ) -> Result<(), String> {
        if let Some(outcome) = done.get(name) {
            return outcome.clone();
        }
        // A command that needed itself would find this.
        done.insert(name.into(), Err(format!("`{name}` needs its own output")));
        let outcome = self.run_with_needed(name, done);
        done.insert(name.into(), outcome.clone());
        outcome
    }

    fn run_with_needed(
        &self,
        name: &str,
        done: &mut BTreeMap<String, Result<(), String>>,
    ) -> Result<(), String> {
        let recipe =
            self.registry.commands.get(name).ok_or_else(|| format!("no command is called `{name}`"))?;
        for needed in recipe.needs().filter(|needed| *needed != name) {
            self.run(needed, done).map_err(|error| format!("`{needed}`, which it needs: {error}"))?;
        }
        if self.reuse && self.folder_of(name).join(STEPS).is_file() {
            println!("xtask: {name}: as it was");
            return Ok(());
        }
        self.run_lines(name, recipe).map_err(|error| format!("{error:#}"))
    }

    fn run_lines(&self, name: &str, recipe: &Recipe) -> Result<()> {
        let folder = self.folder_of(name);
        if folder.exists() {
            fs::remove_dir_all(&folder)?;
        }
        fs::create_dir_all(&folder)?;
        for file in &recipe.copy {
            let from = self.root.join(file);
            let to = folder.join(from.file_name().context("a file to copy has no name")?);
            fs::copy(&from, to).with_context(|| from.display().to_string())?;
        }
        let mut output = fs::File::create(folder.join("stdout"))?;
        let mut steps = Vec::new();
        for line in &recipe.run {
            println!("xtask: {name}: {line}");
            let start = Instant::now();
            let errors = fs::File::create(folder.join("stderr"))?;
            let filled = self.filled(line)?;
            let mut command = self.command(&filled, &folder)?;
            let finished = command.stdin(Stdio::null()).stderr(errors).output();
            let finished = finished.with_context(|| format!("`{line}` could not be started"))?;
            output.write_all(&finished.stdout)?;
            if !finished.status.success() {
                let said = fs::read_to_string(folder.join("stderr")).unwrap_or_default();
                let last = said.trim_end().lines().last().unwrap_or("nothing on stderr").to_owned();
                bail!("`{line}` failed ({}): {last}", finished.status);
            }
            if let Some(filter) = tested::none_ran(&filled, &finished.stdout, &folder) {
                bail!("`{line}` ran no test: no name of one has {filter}");
            }
            steps.push(json!({ "line": line, "seconds": start.elapsed().as_secs_f64() }));
        }
        fs::write(folder.join(STEPS), json!({ "steps": steps }).to_string())?;
        Ok(())
    }

    /// A filled command line as a process of the shell.
    fn command(&self, line: &str, folder: &Path) -> Result<Command> {
        let mut command = Command::new("sh");
        command.arg("-ec").arg(line).current_dir(folder);
        let own = self.program.parent().map(Path::to_path_buf);
        let path = std::env::var_os("PATH").unwrap_or_default();
        let folders = own.into_iter().chain(std::env::split_paths(&path));
        command.env("PATH", std::env::join_paths(folders)?);
        Ok(command)
    }

    /// A line with what its braces name.
    fn filled(&self, line: &str) -> Result<String> {
        let mut filled = line.replace("{repo}", &self.root.display().to_string());
        if filled.contains("{data}") {
            let data =
                std::env::var_os("LOBELIA_DATA").map_or(self.root.join("../shared/data"), PathBuf::from);
            if !data.is_dir() {
                bail!(
                    "it needs measured data, which are no part of the repository: name their folder in \
                     LOBELIA_DATA"
                );
            }
            filled = filled.replace("{data}", &data.display().to_string());
        }
        if filled.contains("{python}") {
            let python = crate::peers::python::venv(&["numpy", "zarr", "OpenEXR"])?;
            filled = filled.replace("{python}", &self.root.join(python).display().to_string());
        }
        for name in self.registry.commands.keys() {
            filled = filled.replace(&format!("{{{name}}}"), &self.folder_of(name).display().to_string());
        }
        Ok(filled)
    }

    /// An output of a command.
    pub(super) fn output(&self, name: &str, output: &str) -> Result<Output> {
        let file = if output == "steps" { STEPS } else { output };
        let path = match file.strip_prefix("{repo}/") {
            Some(file) => self.root.join(file),
            None => self.folder_of(name).join(file),
        };
        let text = fs::read_to_string(&path).with_context(|| path.display().to_string())?;
        let parsed = match path.extension().and_then(|extension| extension.to_str()) {
            Some("json") => Some(serde_json::from_str(&text).with_context(|| path.display().to_string())?),
            Some("toml") => {
                let table: toml::Value = toml::from_str(&text).with_context(|| path.display().to_string())?;
                Some(serde_json::to_value(table)?)
            }
            _ => None,
        };
        Ok(parsed.map_or(Output::Text(text), Output::Document))
    }
}
