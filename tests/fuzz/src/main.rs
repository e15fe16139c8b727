//! `sgs-fuzz`: damaged files for every reader, for so many seconds.
//!
//! Each target runs in a process of its own, so that one that ends it (no memory, no stack, no end) is a finding too.

use clap::Parser;
use sgs_fuzz::{Campaign, Counting, TARGETS, Tally, Target, find, quietly, write_seeds};
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};
use std::time::{Duration, Instant};

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Processor time after which an input counts as one without end.
const PATIENCE: u64 = 30;

#[derive(Parser)]
#[command(about = "Damaged files for every reader of SGS")]
struct Cli {
    /// How long each target is fed.
    #[arg(long, default_value_t = 60.0)]
    seconds: f64,
    /// At most so many inputs for each.
    #[arg(long, default_value_t = u64::MAX)]
    inputs: u64,
    /// Which targets; all, if there is none.
    #[arg(long)]
    target: Vec<String>,
    /// What the changes depend on.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Where inputs go at which a reader fails.
    #[arg(long, default_value = "findings")]
    output: PathBuf,
    /// Try this file alone, and say what it came to.
    #[arg(long)]
    file: Option<PathBuf>,
    /// Lists the targets.
    #[arg(long)]
    list: bool,
    /// Writes the files that the corpus begins with below a folder.
    #[arg(long, value_name = "DIR")]
    seeds: Option<PathBuf>,
    /// Feeds one target in this process; where each input is put first.
    #[arg(long, hide = true)]
    current: Option<PathBuf>,
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
    if let Some(current) = &cli.current {
        let [target] = chosen[..] else { return Err("--current needs one --target".into()) };
        return Ok(feed(cli, target, current));
    }
    let mut found = 0;
    println!(
        "{:<22} {:>9} {:>8} {:>6} {:>9} {:>9} {:>8}",
        "target", "inputs", "seconds", "said", "slowest", "memory", "found"
    );
    for target in chosen {
        found += parent(cli, target)?;
    }
    Ok(if found == 0 { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// Feeds a target and says what it came to, on lines that the parent reads.
fn feed(cli: &Cli, target: &Target, current: &Path) -> ExitCode {
    quietly();
    watch();
    let mut campaign = Campaign::new(target, cli.seed);
    campaign.current = Some(current.to_owned());
    let Tally { inputs, said, time, slowest, most_memory, findings } =
        campaign.run(cli.inputs, Duration::from_secs_f64(cli.seconds));
    for finding in &findings {
        keep(cli, target, &finding.what, &finding.input);
    }
    let (time, slowest) = (time.as_secs_f64(), slowest.as_secs_f64());
    let memory = most_memory as f64 / f64::from(1 << 20);
    let count = findings.len();
    println!("{:<22} {inputs:>9} {time:>8.0} {said:>6} {slowest:>7.2} s {memory:>6.0} MiB {count:>6}", target.name);
    ExitCode::from(u8::from(count > 0))
}

/// Writes an input at which a reader fails.
fn keep(cli: &Cli, target: &Target, what: &str, input: &[u8]) {
    let hash = input.iter().fold(0xcbf2_9ce4_8422_2325_u64, |h, b| (h ^ u64::from(*b)).wrapping_mul(0x100_0000_01b3));
    let file = cli.output.join(format!("{}-{hash:016x}", target.name));
    let written = std::fs::create_dir_all(&cli.output).and_then(|()| std::fs::write(&file, input));
    let place = written.map_or_else(|e| e.to_string(), |()| file.display().to_string());
    println!("{}: {what}; {} bytes in {place}", target.name, input.len());
}

/// Feeds a target in a process of its own, and again with another seed where that ends early. How much was found.
fn parent(cli: &Cli, target: &Target) -> Result<u64, String> {
    let folder = sgs_fuzz::Place::new();
    let current = folder.path("current");
    let program = std::env::current_exe().map_err(|e| e.to_string())?;
    let start = Instant::now();
    let mut found = 0;
    for seed in cli.seed.. {
        let left = cli.seconds - start.elapsed().as_secs_f64();
        if seed > cli.seed && left < 1.0 {
            break;
        }
        let mut child = Command::new(&program);
        child.args(["--target", target.name]).arg("--current").arg(&current).arg("--output").arg(&cli.output);
        child.args(["--seed", &seed.to_string(), "--inputs", &cli.inputs.to_string(), "--seconds", &left.to_string()]);
        let status = child.status().map_err(|e| e.to_string())?;
        match status.code() {
            Some(0) => break,
            Some(1) => {
                found += 1;
                break;
            }
            _ => {
                found += 1;
                let input = std::fs::read(&current).unwrap_or_default();
                keep(cli, target, &format!("the process ended ({status})"), &input);
            }
        }
        if found > 20 {
            break;
        }
    }
    Ok(found)
}

/// Ends the process when an input takes too much of the processor's time. Clocks on the wall say nothing on a busy machine.
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

/// Processor time of this process so far, in hundredths of a second; 0 where the system does not say.
fn used() -> u64 {
    let text = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let after = text.rsplit(')').next().unwrap_or_default();
    after.split_whitespace().skip(11).take(2).filter_map(|n| n.parse::<u64>().ok()).sum()
}
