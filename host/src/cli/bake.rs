//! `lobelia bake`: what a method prepares of a scene once, stored.

use std::path::PathBuf;

use super::Context;
use super::environment::EnvironmentArgs;
use super::incident::IncidentArgs;
use super::methods::{self, MethodArg};
use crate::chart::Table;
use crate::error::{Error, Result};
use crate::fit::chunks::Part;
use crate::page::numbers;
use crate::progress::{self, counted};
use crate::render::bake::{self, Held, Outcome, Task};
use crate::render::{Method, Settings};
use crate::scene::Scene;

/// Arguments of `lobelia bake`.
#[derive(Debug, clap::Args)]
pub(super) struct BakeArgs {
    /// The scene: a .toml file, or one that is shipped
    #[arg(required_unless_present_any = ["merge", "list"])]
    scene: Option<PathBuf>,
    /// The method that it is baked for
    #[arg(long, value_parser = methods::that_bake(), required_unless_present_any = ["merge", "list"])]
    method: Option<MethodArg>,
    /// Folder for what is baked. A bake that was killed goes on in it
    #[arg(short, long, value_name = "DIR", required_unless_present = "list")]
    output: Option<PathBuf>,
    /// Bakes chunk I of N alone, for several machines; chunks may share a folder
    #[arg(long, value_name = "I/N", conflicts_with_all = ["merge", "list"])]
    chunks: Option<Part>,
    /// Joins the folders of chunks into one
    #[arg(long, value_name = "DIR", num_args = 1.., conflicts_with_all = ["scene", "method", "list"])]
    merge: Vec<PathBuf>,
    /// Tells what folders hold, themselves or those in them: method, settings, parts, size and age
    #[arg(long, value_name = "DIR", num_args = 1.., conflicts_with_all = ["scene", "method", "output"])]
    list: Vec<PathBuf>,
    /// Bakes one part, tells what the others will take, and stops
    #[arg(long, conflicts_with_all = ["merge", "list"])]
    estimate: bool,
    #[command(flatten)]
    environment: EnvironmentArgs,
    #[command(flatten)]
    incident: IncidentArgs,
}

/// Runs `lobelia bake`.
pub(super) fn run(args: &BakeArgs, context: &mut Context) -> Result<()> {
    if !args.list.is_empty() {
        print!("{}", table(&bake::list(&args.list)?));
        return Ok(());
    }
    let Some(output) = args.output.as_deref() else {
        return Err(Error::input("name the folder for what is baked: -o DIR"));
    };
    if !args.merge.is_empty() {
        args.merge.iter().for_each(|folder| context.report.input(folder));
        let merged = context.report.stage("merge", || bake::merge(&args.merge, output))?;
        let parts = counted(merged.parts() as u64, "part", "parts");
        println!("{}: {parts}, {}", output.display(), numbers::bytes(merged.bytes));
        return Ok(());
    }
    let (Some(name), Some(MethodArg(Some(method)))) = (&args.scene, args.method) else {
        return Err(Error::input("name the scene and --method"));
    };
    if name.exists() {
        context.input_with_parts(name);
    }
    let scene = context.report.stage("load", || Scene::open(name))?;
    method.check(&scene)?;
    let environment = args.environment.settings(Some(method), None, context.seed)?;
    let incident = args.incident.settings(Some(method), None, context.seed)?;
    let renderer = (method.renderer)(&Settings { environment, incident, ..Settings::default() });
    let task = Task { folder: output, chunk: args.chunks, estimate_only: args.estimate };
    let mut told = String::new();
    let outcome = bake::bake(renderer.as_ref(), &scene, task, |estimate| {
        told = format!(
            "{} to bake: about {}, {} on disk",
            counted(estimate.parts as u64, "part", "parts"),
            numbers::seconds(estimate.seconds),
            numbers::bytes(estimate.bytes)
        );
        progress::note(&told);
    })?;
    report(method, &outcome, context);
    if args.estimate {
        println!("{}: {}", output.display(), if told.is_empty() { "nothing is left to bake" } else { &told });
        return Ok(());
    }
    if outcome.damaged > 0 {
        let damaged = counted(outcome.damaged as u64, "part was", "parts were");
        context.note(format!("{damaged} damaged, and baked again"));
    }
    let Outcome { parts: [made, there, all], .. } = outcome;
    let before = if there > 0 { format!(", {there} before") } else { String::new() };
    let waiting = match outcome.waiting {
        0 => String::new(),
        waiting => format!(
            "; {waiting} more need parts of other chunks: merge those into a folder and bake on there"
        ),
    };
    println!(
        "{}: {} of {all} baked{before}, {}: {:.1} s{waiting}",
        output.display(),
        counted(made as u64, "part", "parts"),
        numbers::bytes(outcome.bytes),
        outcome.seconds
    );
    Ok(())
}

/// Notes what was done.
fn report(method: &Method, outcome: &Outcome, context: &mut Context) {
    let report = &mut context.report;
    report.stages.push(crate::report::Stage { name: "bake".into(), seconds: outcome.seconds });
    report.figure("method", method.name);
    report.figure("bake_seconds", outcome.seconds);
    report.figure("bake_rays", outcome.rays);
    report.figure("baked_bytes", outcome.bytes);
    report.figure("parts", outcome.parts.to_vec());
    report.figure("waiting", outcome.waiting);
}

/// What folders hold, a row each.
fn table(held: &[Held]) -> Table {
    let mut table = Table::new(["folder", "method", "settings", "parts", "size", "baked in", "age", "of"]);
    for Held { path, made_of, parts: [there, all], bytes, bake_seconds, age_seconds } in held {
        // Of a hash its beginning is enough to tell folders apart.
        let of = made_of.of.iter().map(|(name, value)| match value.len() {
            64 => format!("{name} {}", &value[..8.min(value.len())]),
            _ => format!("{name} {value}"),
        });
        table.row([
            path.display().to_string().into(),
            made_of.method.as_str().into(),
            made_of.settings.as_str().into(),
            if there == all { all.to_string() } else { format!("{there} of {all}") }.into(),
            numbers::bytes(*bytes).into(),
            progress::duration(*bake_seconds).into(),
            progress::duration(*age_seconds).into(),
            of.collect::<Vec<_>>().join(", ").into(),
        ]);
    }
    table
}
