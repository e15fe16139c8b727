//! Fuzzing of a target: the corpus, mutations of it, and minimized findings.

use crate::corpus::corpus;
use crate::count;
use crate::coverage::Coverage;
use crate::mutate::{Generator, Rng};
use crate::place::Place;
use crate::target::Target;
use std::collections::HashSet;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Memory that every input may use, in bytes.
const FREE: usize = 64 << 20;

/// Maximum memory beyond [`FREE`], in bytes: a few times the largest image that is read.
const MOST: usize = 512 << 20;

/// Maximum number of grown inputs of a target. Every turn starts with all of them.
const MOST_GROWN: usize = 4000;

/// Maximum total size of the grown inputs, in bytes.
const MOST_GROWN_BYTES: usize = 64 << 20;

/// Number of inputs between checks of all blocks of counters.
const CHECK_INTERVAL: usize = 32;

/// Message of the last panic.
static PANIC: Mutex<String> = Mutex::new(String::new());

/// Number of inputs that were started.
static TAKEN: AtomicU64 = AtomicU64::new(0);

/// Returns the number of inputs that this process has started.
pub fn taken() -> u64 {
    TAKEN.load(Ordering::Relaxed)
}

/// Hides panics from the terminal and records their messages for findings.
///
/// Call this function once per program.
pub fn quietly() {
    std::panic::set_hook(Box::new(|info| {
        let place = info.location().map(|l| format!("{}:{}", l.file(), l.line())).unwrap_or_default();
        let payload = info.payload();
        let text = payload.downcast_ref::<&str>().copied();
        let message = text.or_else(|| payload.downcast_ref::<String>().map(String::as_str)).unwrap_or("something");
        *PANIC.lock().unwrap_or_else(PoisonError::into_inner) = format!("panic at {place}: {message}");
    }));
}

/// Input at which a reader fails.
#[derive(Clone, Debug)]
pub struct Finding {
    /// Description of the failure.
    pub what: String,
    /// Minimized input.
    pub input: Vec<u8>,
}

/// Results of a campaign.
#[derive(Clone, Debug, Default)]
pub struct Tally {
    /// Number of inputs.
    pub inputs: u64,
    /// Number of different results of the target, without numbers and names.
    pub results: usize,
    /// Branches that inputs took; `None` if the program does not count branches.
    pub branches: Option<usize>,
    /// Wall time of the campaign.
    pub time: Duration,
    /// Longest time of an input.
    pub slowest: Duration,
    /// Largest memory of an input, in bytes.
    pub most_memory: usize,
    /// Findings, one of each kind.
    pub findings: Vec<Finding>,
}

/// Fuzzing of one target.
pub struct Campaign<'a> {
    target: &'a Target,
    generator: Generator,
    random: Rng,
    /// File to which each input is written first, to keep inputs that end the process.
    pub current: Option<PathBuf>,
    /// Directory of grown inputs, kept from run to run.
    pub grown: Option<PathBuf>,
    /// Number of inputs and bytes that may still be added to the directory.
    room: [usize; 2],
    results: HashSet<String>,
    coverage: Coverage,
    /// Inputs since the last check of all counters.
    recent: Vec<Vec<u8>>,
    kinds: HashSet<String>,
    tally: Tally,
}

impl<'a> Campaign<'a> {
    /// Creates a campaign with the corpus of the target.
    pub fn new(target: &'a Target, seed: u64) -> Campaign<'a> {
        let files = corpus(target).into_values().collect();
        Campaign {
            target,
            generator: Generator::new(target, files),
            random: Rng::new(seed ^ target.name.bytes().fold(0, |h: u64, b| h.wrapping_mul(31).wrapping_add(b.into()))),
            current: None,
            grown: None,
            room: [0; 2],
            results: HashSet::new(),
            coverage: Coverage::of_program(),
            recent: Vec::new(),
            kinds: HashSet::new(),
            tally: Tally::default(),
        }
    }

    /// Runs the corpus, and then mutations up to a number of inputs or a time.
    pub fn run(mut self, inputs: u64, time: Duration) -> Tally {
        let start = Instant::now();
        for bytes in corpus(self.target).values() {
            let _new = self.take_wholly(bytes);
        }
        self.room = [MOST_GROWN, MOST_GROWN_BYTES];
        // Short inputs first: a longer input that takes no more branches is not needed.
        for file in self.grown.as_deref().map(by_length).unwrap_or_default() {
            let Ok(input) = std::fs::read(&file) else { continue };
            let found = self.tally.findings.len();
            // New inputs stay in the directory, and failing ones become findings. All others are removed.
            if !self.take_wholly(&input) && found == self.tally.findings.len() {
                let _still_there = std::fs::remove_file(file);
            }
        }
        // Memory of the first inputs includes initialization of the readers.
        self.tally.most_memory = 0;
        while self.tally.inputs < inputs && start.elapsed() < time {
            let input = self.generator.next(&mut self.random);
            let _new = self.take(&input);
            self.check_counters(input);
        }
        self.tally.results = self.results.len();
        self.tally.branches = self.coverage.counts().then(|| self.coverage.branches());
        self.tally.time = start.elapsed();
        self.tally
    }

    /// Checks all blocks of counters after every [`CHECK_INTERVAL`] inputs.
    ///
    /// If inputs took branches in new blocks, runs the last inputs again with these blocks included.
    fn check_counters(&mut self, input: Vec<u8>) {
        self.recent.push(input);
        if self.recent.len() == CHECK_INTERVAL {
            let recent = std::mem::take(&mut self.recent);
            if self.coverage.elsewhere() {
                for input in &recent {
                    let _new = self.take(input);
                }
            }
        }
    }

    /// Writes an input to the grown corpus; a failed write is ignored.
    fn grow(&mut self, input: &[u8]) {
        let [inputs, bytes] = self.room;
        let Some(folder) = self.grown.as_ref().filter(|_| inputs > 0 && input.len() <= bytes) else { return };
        self.room = [inputs - 1, bytes - input.len()];
        let file = folder.join(format!("{:016x}", hash(input)));
        if !file.exists() {
            let _unwritten = std::fs::create_dir_all(folder).and_then(|()| std::fs::write(&file, input));
        }
    }

    /// Runs an input, and again if it took branches in new blocks.
    ///
    /// Returns true if the input is new.
    fn take_wholly(&mut self, input: &[u8]) -> bool {
        let new = self.take(input);
        if self.coverage.elsewhere() { self.take(input) } else { new }
    }

    /// Runs an input and records its result. Returns true if the result is new.
    fn take(&mut self, input: &[u8]) -> bool {
        if let Some(file) = &self.current {
            // If the write fails, only an input that ends the process is lost.
            let _unwritten = std::fs::write(file, input);
        }
        self.tally.inputs += 1;
        self.coverage.begin();
        let begun = Instant::now();
        let came = attempt(self.target, input);
        self.tally.slowest = self.tally.slowest.max(begun.elapsed());
        match came {
            Ok((result, memory)) => {
                self.tally.most_memory = self.tally.most_memory.max(memory);
                let words = self.results.insert(shape(&result));
                // Messages alone may be new without end, since they contain names.
                let new = if self.coverage.counts() { self.coverage.is_new() } else { words };
                if new {
                    self.generator.keep(input);
                    self.grow(input);
                }
                new
            }
            Err(what) => {
                if self.kinds.insert(kind(&what)) {
                    let input = smaller(self.target, input, &what);
                    self.tally.findings.push(Finding { what, input });
                }
                true
            }
        }
    }
}

/// Lists the files of a directory, ordered by length and then by name.
///
/// Returns paths, since the files together may be too large for memory.
fn by_length(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut files: Vec<_> = entries.filter_map(|e| Some((e.metadata().ok()?.len(), e.path()))).collect();
    files.sort();
    files.into_iter().map(|(_, file)| file).collect()
}

/// Runs an input. Returns the target's result and the memory, or the failure.
pub(crate) fn attempt(target: &Target, input: &[u8]) -> Result<(String, usize), String> {
    TAKEN.fetch_add(1, Ordering::Relaxed);
    let begun = count::begin();
    let result = catch_unwind(AssertUnwindSafe(|| (target.run)(input)));
    let memory = count::most(begun);
    let Ok(result) = result else {
        // A panic may leave the files around the input incomplete.
        Place::forget();
        return Err(std::mem::take(&mut *PANIC.lock().unwrap_or_else(PoisonError::into_inner)));
    };
    // Some inputs have another size when they are read, so a fixed amount is always allowed.
    let allowed = FREE + target.per_byte.saturating_mul(input.len()).min(MOST);
    match memory > allowed {
        true => Err(format!("memory: {memory} bytes for an input of {}", input.len())),
        false => Ok((result, memory)),
    }
}

/// Strips numbers and names from a result, to identify the path through the reader.
fn shape(result: &str) -> String {
    let mut quoted = false;
    let mut out = String::new();
    for c in result.chars() {
        match c {
            '"' => quoted = !quoted,
            _ if quoted => {}
            c if c.is_ascii_digit() || c == '.' || c == '-' => {
                if !out.ends_with('0') {
                    out.push('0');
                }
            }
            c => out.push(c),
        }
        if out.len() > 2000 {
            break;
        }
    }
    out
}

/// Returns a hash that names an input (FNV-1a).
pub fn hash(input: &[u8]) -> u64 {
    input.iter().fold(0xcbf2_9ce4_8422_2325_u64, |h, b| (h ^ u64::from(*b)).wrapping_mul(0x100_0000_01b3))
}

/// Returns the kind of a failure: its place or its category.
fn kind(what: &str) -> String {
    what.split(": ").next().unwrap_or_default().to_owned()
}

/// Removes parts of an input as long as it fails in the same way.
///
/// Takes about five seconds at most.
fn smaller(target: &Target, input: &[u8], what: &str) -> Vec<u8> {
    let mut best = input.to_vec();
    let until = Instant::now() + Duration::from_secs(5);
    let mut step = best.len().div_ceil(2);
    while step > 0 && Instant::now() < until {
        let mut at = 0;
        while at < best.len() && Instant::now() < until {
            let mut shorter = best.clone();
            shorter.drain(at..(at + step).min(best.len()));
            match attempt(target, &shorter) {
                Err(again) if kind(&again) == kind(what) => best = shorter,
                _ => at += step,
            }
        }
        step /= 2;
    }
    best
}
