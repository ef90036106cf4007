//! The command line: one file per command.

/// Prints a line to stdout. That nobody reads it any more (`relight train … | head`) stops no work.
macro_rules! say {
    ($($text:tt)*) => {
        _ = std::io::Write::write_fmt(&mut std::io::stdout(), format_args!("{}\n", format_args!($($text)*)))
    };
}

pub mod animation;
pub mod bake;
pub mod bench;
pub mod choose;
pub mod compare;
pub mod cornell;
pub mod export;
pub mod export_conditions;
pub mod failure;
pub mod info;
pub mod lights;
pub mod pipeline;
pub mod render;
pub mod reporter;
pub mod settings;
pub mod storage;
pub mod study;
pub mod train;
#[cfg(feature = "viewer")]
pub mod view;

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::{Parser, Subcommand};

use crate::files::{check_writable, write_whole};
use crate::memory::return_freed_memory;
pub use failure::Failure;
pub use reporter::Reporter;

/// Trains a direct-to-indirect light transfer for one asset and relights the asset with it.
///
/// Without a command: trains on the built-in Cornell box, compares with the paper's baseline and classical SH PRT, and
/// writes out/cornell.relight, out/report.html and pictures.
#[derive(Parser)]
#[command(version, max_term_width = 100)]
struct Arguments {
    #[command(subcommand)]
    command: Option<Command>,
    /// Threads to use [default: all processors]; results do not depend on it
    #[arg(long, global = true, value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// Write the figures to FILE as JSON
    #[arg(long, global = true, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Write progress and notes to FILE, too
    #[arg(long, global = true, value_name = "FILE")]
    log: Option<PathBuf>,
}

#[derive(Subcommand)]
enum Command {
    Train(train::Train),
    Compare(compare::Compare),
    Render(render::Render),
    #[cfg(feature = "viewer")]
    View(view::View),
    Bake(bake::Bake),
    Bench(bench::Bench),
    Export(export::Export),
    ExportConditions(export_conditions::ExportConditions),
    Info(info::Info),
}

/// Parses the arguments, runs the command, prints one line for a failure. Exit status 0: done, 1: the work failed or was
/// stopped, 2: the input or the arguments are wrong.
pub fn run() -> ExitCode {
    let arguments = Arguments::parse();
    let log = match arguments.log.as_ref().map(|path| (path, std::fs::File::create(path))) {
        Some((path, Err(error))) => {
            let failure = Failure::Work(format!("{}: cannot be written: {error}", path.display()));
            return failure.report(&Reporter::new(None));
        }
        Some((_, Ok(file))) => Some(file),
        None => None,
    };
    let reporter = Reporter::new(log);
    return_freed_memory();
    if let Some(threads) = arguments.threads
        && let Err(error) = rayon::ThreadPoolBuilder::new().num_threads(threads as usize).build_global()
    {
        return Failure::Work(format!("cannot start {threads} threads: {error}")).report(&reporter);
    }
    // Linear algebra runs inside our own tasks; threads of its own would make rounding depend on their number.
    faer::set_global_parallelism(faer::Par::Seq);
    let json = arguments.json.as_deref();
    let result = match &arguments.command {
        Some(Command::Train(train)) => train.run(json, &reporter),
        Some(Command::Compare(compare)) => compare.run(json, &reporter),
        Some(Command::Render(render)) => render.run(json, &reporter),
        #[cfg(feature = "viewer")]
        Some(Command::View(view)) => view.run(&reporter),
        Some(Command::Bake(bake)) => bake.run(json, &reporter),
        Some(Command::Bench(bench)) => bench.run(json, &reporter),
        Some(Command::Export(export)) => export.run(json, &reporter),
        Some(Command::ExportConditions(export)) => export.run(json, &reporter),
        Some(Command::Info(info)) => info.run(json, &reporter),
        None => cornell::run(json, &reporter),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => failure.report(&reporter),
    }
}

/// Writes a command's figures, where asked for.
fn write_json(path: Option<&Path>, figures: &serde_json::Value) -> Result<(), Failure> {
    let Some(path) = path else { return Ok(()) };
    let text = format!("{figures:#}\n");
    write_file(path, text.as_bytes())
}

/// Refuses a result's place before the work for it begins.
fn check_output(path: &Path) -> Result<(), Failure> {
    check_writable(path).map_err(|error| Failure::Work(format!("{}: cannot be written: {error}", path.display())))
}

/// Writes a result file.
fn write_file(path: &Path, bytes: &[u8]) -> Result<(), Failure> {
    write_whole(path, bytes).map_err(|error| Failure::Work(format!("{}: cannot be written: {error}", path.display())))
}
