//! `sgs-fuzz`: feeds damaged files to every reader for a number of seconds.
//!
//! Each target runs in its own process, so that an input that ends the process (no memory, no stack, no end) is a
//! finding. With a ledger, targets take turns until each has been fuzzed for the requested time, over as many runs as
//! that takes.

mod hook;
mod ledger;

use clap::Parser;
use ledger::{Fed, Ledger};
use sgs_fuzz::{Campaign, Counting, TARGETS, Tally, Target, corpus, distill, files, find, hash, quietly, write_seeds};
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode, Stdio};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Processor time per input, in seconds; an input that exceeds the time is a hang.
const PATIENCE: u64 = 30;

/// Seconds of a turn. With a ledger, another target follows.
const TURN: f64 = 120.0;

#[derive(Parser)]
#[command(about = "Damaged files for every reader of SGS")]
struct Cli {
    /// Seconds to fuzz each target; with a ledger, processor seconds over all runs.
    #[arg(long, default_value_t = 60.0)]
    seconds: f64,
    /// Adds the time of each target to this file and continues from the file.
    #[arg(long, value_name = "FILE")]
    ledger: Option<PathBuf>,
    /// Number of targets that run at a time, with a ledger.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=256))]
    jobs: u32,
    /// Reads inputs that took new branches from DIR/TARGET and writes new ones there.
    #[arg(long, value_name = "DIR")]
    grown: Option<PathBuf>,
    /// Adds grown inputs to the corpus if they take branches that the corpus misses.
    /// Adds at most BYTES per target; a file costs 200 bytes more than its size.
    #[arg(long, value_name = "BYTES", requires = "grown", conflicts_with = "ledger")]
    distill: Option<usize>,
    /// Maximum number of inputs for each target.
    #[arg(long, default_value_t = u64::MAX)]
    inputs: u64,
    /// Targets to run; all by default.
    #[arg(long)]
    target: Vec<String>,
    /// Seed of the mutations.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Directory for inputs at which a reader fails.
    #[arg(long, default_value = "findings")]
    output: PathBuf,
    /// Runs one target on this file and prints the result.
    #[arg(long)]
    file: Option<PathBuf>,
    /// Lists the targets.
    #[arg(long)]
    list: bool,
    /// Adds the initial inputs to the corpora in a directory.
    #[arg(long, value_name = "DIR")]
    seeds: Option<PathBuf>,
    /// Adds this file to the corpus of one target.
    #[arg(long, value_name = "FILE")]
    add: Option<PathBuf>,
    /// Writes the inputs of the corpora to DIR/TARGET/NAME, for libFuzzer.
    #[arg(long, value_name = "DIR")]
    unpack: Option<PathBuf>,
    /// Fuzzes one target in this process; writes each input to this file first.
    #[arg(long, hide = true)]
    current: Option<PathBuf>,
    /// Writes the results of that target to this file.
    #[arg(long, hide = true)]
    tally: Option<PathBuf>,
}

fn main() -> ExitCode {
    let cli = Cli::parse();
    match run(&cli) {
        Ok(code) => code,
        Err(problem) => {
            eprintln!("sgs-fuzz: {problem}");
            ExitCode::from(2)
        }
    }
}

fn run(cli: &Cli) -> Result<ExitCode, String> {
    if cli.list {
        TARGETS.iter().for_each(|t| println!("{}", t.name));
        return Ok(ExitCode::SUCCESS);
    }
    if let Some(folder) = &cli.seeds {
        write_seeds(folder).map_err(|e| e.to_string())?;
        return Ok(ExitCode::SUCCESS);
    }
    let unknown = |name: &String| format!("there is no target \"{name}\"; --list names all");
    let chosen = cli.target.iter().map(|n| find(n).ok_or_else(|| unknown(n))).collect::<Result<Vec<_>, _>>()?;
    let chosen = if chosen.is_empty() { TARGETS.iter().collect() } else { chosen };
    if let Some(file) = &cli.file {
        let [target] = chosen[..] else { return Err("--file needs one --target".into()) };
        let bytes = std::fs::read(file).map_err(|e| e.to_string())?;
        println!("{}", (target.run)(&bytes));
        return Ok(ExitCode::SUCCESS);
    }
    if let Some(file) = &cli.add {
        let [target] = chosen[..] else { return Err("--add needs one --target".into()) };
        let bytes = std::fs::read(file).map_err(|e| format!("{}: {e}", file.display()))?;
        let name = file.file_name().map_or_else(|| hash(&bytes).to_string(), |n| n.to_string_lossy().into_owned());
        add(target, [(name, bytes)])?;
        return Ok(ExitCode::SUCCESS);
    }
    if let Some(folder) = &cli.unpack {
        let unpacked = chosen.into_iter().try_for_each(|target| unpack(target, folder));
        return unpacked.map(|()| ExitCode::SUCCESS).map_err(|e| format!("{}: {e}", folder.display()));
    }
    if let (Some(room), Some(grown)) = (cli.distill, &cli.grown) {
        quietly();
        return chosen.into_iter().try_for_each(|t| distilled(t, grown, room)).map(|()| ExitCode::SUCCESS);
    }
    if let Some(current) = &cli.current {
        let [target] = chosen[..] else { return Err("--current needs one --target".into()) };
        return Ok(feed(cli, target, current));
    }
    println!(
        "{:<22} {:>9} {:>8} {:>6} {:>8} {:>9} {:>9} {:>8}",
        "target", "inputs", "seconds", "said", "branches", "slowest", "memory", "found"
    );
    let found = match &cli.ledger {
        Some(file) => in_turns(cli, &chosen, file)?,
        None => chosen.into_iter().map(|target| parent(cli, target)).sum::<Result<u64, String>>()?,
    };
    Ok(if found == 0 { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// Fuzzes a target and prints its results.
fn feed(cli: &Cli, target: &Target, current: &Path) -> ExitCode {
    quietly();
    watch();
    let mut campaign = Campaign::new(target, cli.seed);
    campaign.current = Some(current.to_owned());
    campaign.grown = cli.grown.as_ref().map(|folder| folder.join(target.name));
    let Tally { inputs, results, branches, time, slowest, most_memory, findings } =
        campaign.run(cli.inputs, Duration::from_secs_f64(cli.seconds));
    for finding in &findings {
        keep(cli, target, &finding.what, &finding.input);
    }
    let (time, slowest) = (time.as_secs_f64(), slowest.as_secs_f64());
    if let Some(file) = &cli.tally {
        let seconds = used() as f64 / 100.0;
        let fed = Fed {
            seconds,
            guided: if branches.is_some() { seconds } else { 0.0 },
            branches: branches.unwrap_or(0) as u64,
            wall: time,
            inputs,
            slices: 1,
            most_memory: most_memory as u64,
            findings: findings.len() as u64,
        };
        // Without the file the turn does not count.
        let _unwritten = serde_json::to_vec(&fed).map(|text| std::fs::write(file, text));
    }
    let memory = most_memory as f64 / f64::from(1 << 20);
    let count = findings.len();
    let branches = branches.map_or_else(|| "-".into(), |n| n.to_string());
    println!(
        "{:<22} {inputs:>9} {time:>8.0} {results:>6} {branches:>8} {slowest:>7.2} s {memory:>6.0} MiB {count:>6}",
        target.name
    );
    ExitCode::from(u8::from(count > 0))
}

/// Adds inputs to the corpus that take branches that the corpus misses.
fn distilled(target: &Target, grown: &Path, room: usize) -> Result<(), String> {
    let inputs: Vec<Vec<u8>> = files(&grown.join(target.name)).into_iter().map(|(_, input)| input).collect();
    let uncounted = "branches are not counted; build with --config tests/fuzz/coverage.toml (docs/project/testing.md)";
    let (chosen, more) = distill(target, &inputs, room).ok_or(uncounted)?;
    let (count, bytes) = (chosen.len(), chosen.iter().map(Vec::len).sum::<usize>());
    if count > 0 {
        add(target, chosen.into_iter().map(|input| (format!("grown-{:016x}", hash(&input)), input)))?;
    }
    println!("{:<22} {count:>4} of {:>4} inputs, {bytes:>6} bytes, {more:>5} branches more", target.name, inputs.len());
    Ok(())
}

/// Adds inputs to the corpus of a target.
fn add(target: &Target, inputs: impl IntoIterator<Item = (String, Vec<u8>)>) -> Result<(), String> {
    let path = corpus::packed(&corpus::folder(), target.name);
    corpus::add(&path, inputs).map_err(|e| format!("{}: {e}", path.display()))
}

/// Writes the inputs of a corpus to `DIR/TARGET/NAME`.
fn unpack(target: &Target, folder: &Path) -> std::io::Result<()> {
    let folder = folder.join(target.name);
    std::fs::create_dir_all(&folder)?;
    corpus::corpus(target).into_iter().try_for_each(|(name, bytes)| std::fs::write(folder.join(name), bytes))
}

/// Writes an input at which a reader fails, and prints the failure.
fn keep(cli: &Cli, target: &Target, what: &str, input: &[u8]) {
    let file = cli.output.join(format!("{}-{:016x}", target.name, hash(input)));
    let written = std::fs::create_dir_all(&cli.output).and_then(|()| std::fs::write(&file, input));
    let place = written.map_or_else(|e| e.to_string(), |()| file.display().to_string());
    println!("{}: {what}; {} bytes in {place}", target.name, input.len());
}

/// Fuzzes a target in its own process. Returns the number of findings.
///
/// If the process ends early, another starts with the next seed.
fn parent(cli: &Cli, target: &Target) -> Result<u64, String> {
    let start = Instant::now();
    let mut found = 0;
    for seed in cli.seed.. {
        let left = cli.seconds - start.elapsed().as_secs_f64();
        if seed > cli.seed && left < 1.0 {
            break;
        }
        let (fed, ended) = turn(cli, target, seed, left, true)?;
        found += fed.findings;
        if !ended || found > 20 {
            break;
        }
    }
    Ok(found)
}

/// Fuzzes the least fuzzed targets first, until each reaches the requested time.
///
/// Returns the number of findings.
fn in_turns(cli: &Cli, targets: &[&Target], file: &Path) -> Result<u64, String> {
    // Two workers never fuzz one target at a time: the grown corpus has one writer per target.
    let state = Mutex::new((Ledger::open(file)?, Vec::<&str>::new(), 0u64));
    let lock = || state.lock().unwrap_or_else(PoisonError::into_inner);
    let work = || -> Result<(), String> {
        loop {
            let (target, seed, left) = {
                let (ledger, fed, _) = &mut *lock();
                let names = targets.iter().map(|t| t.name);
                let Some(name) = ledger.hungriest(names, cli.seconds, |t| !fed.contains(&t)) else { return Ok(()) };
                fed.push(name);
                let before = ledger.of(name);
                (name, cli.seed + before.slices, (cli.seconds - before.seconds).clamp(1.0, TURN))
            };
            let target = find(target).ok_or("a target is gone")?;
            let (slice, _) = turn(cli, target, seed, left, false)?;
            let (ledger, fed, found) = &mut *lock();
            fed.retain(|t| *t != target.name);
            *found += slice.findings;
            ledger.add(target.name, &slice);
            ledger.write(file)?;
            if *found > 20 {
                return Ok(());
            }
        }
    };
    std::thread::scope(|scope| {
        let workers: Vec<_> = (0..cli.jobs).map(|_| scope.spawn(work)).collect();
        workers.into_iter().try_for_each(|w| w.join().unwrap_or_else(|_| Err("a worker ended".into())))
    })?;
    let (ledger, _, found) = &*lock();
    for target in targets {
        let Fed { seconds, inputs, branches, most_memory, findings, .. } = ledger.of(target.name);
        let memory = most_memory as f64 / f64::from(1 << 20);
        println!("{:<22} {inputs:>9} {seconds:>8.0} {branches:>15} {memory:>16.0} MiB {findings:>6}", target.name);
    }
    Ok(*found)
}

/// Fuzzes a target in its own process.
///
/// Returns its results, and whether an input ended the process.
fn turn(cli: &Cli, target: &Target, seed: u64, seconds: f64, loud: bool) -> Result<(Fed, bool), String> {
    let folder = sgs_fuzz::Place::new();
    let (current, tally) = (folder.path("current"), folder.path("tally"));
    let program = std::env::current_exe().map_err(|e| e.to_string())?;
    let mut child = Command::new(&program);
    child.args(["--target", target.name]).arg("--current").arg(&current).arg("--output").arg(&cli.output);
    child.args(["--seed", &seed.to_string(), "--inputs", &cli.inputs.to_string(), "--seconds", &seconds.to_string()]);
    child.arg("--tally").arg(&tally);
    if let Some(grown) = &cli.grown {
        child.arg("--grown").arg(grown);
    }
    if !loud {
        child.stdout(Stdio::null());
    }
    let begin = Instant::now();
    let status = child.status().map_err(|e| e.to_string())?;
    let fed = std::fs::read(&tally).ok().and_then(|text| serde_json::from_slice::<Fed>(&text).ok());
    match status.code() {
        Some(0 | 1) => Ok((fed.ok_or_else(|| format!("{} did not say what it came to", target.name))?, false)),
        _ => {
            let input = std::fs::read(&current).unwrap_or_default();
            keep(cli, target, &format!("the process ended ({status})"), &input);
            let wall = begin.elapsed().as_secs_f64();
            Ok((Fed { wall, slices: 1, findings: 1, ..Fed::default() }, true))
        }
    }
}

/// Aborts the process when an input takes too much processor time.
///
/// Wall time would be misleading on a busy machine.
fn watch() {
    std::thread::spawn(|| {
        let mut last = (sgs_fuzz::taken(), used());
        loop {
            std::thread::sleep(Duration::from_secs(2));
            let now = (sgs_fuzz::taken(), used());
            if now.0 != last.0 {
                last = now;
            } else if now.1.saturating_sub(last.1) > PATIENCE * 100 {
                eprintln!("an input takes more than {PATIENCE} s");
                std::process::abort();
            }
        }
    });
}

/// Returns the processor time of this process and its finished children.
///
/// The unit is 1/100 s. Returns 0 if the system does not report the time.
fn used() -> u64 {
    let text = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let after = text.rsplit(')').next().unwrap_or_default();
    after.split_whitespace().skip(11).take(4).filter_map(|n| n.parse::<u64>().ok()).sum()
}
