//! A target fed: the corpus first, then changes of it; what goes wrong, made small.

use crate::count;
use crate::coverage::Coverage;
use crate::mutate::{Generator, Rng};
use crate::place::Place;
use crate::target::{Target, corpus};
use std::collections::HashSet;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Memory that is always allowed.
const FREE: usize = 64 << 20;

/// And no more beyond, whatever its size: the largest image that is read, a few times over.
const MOST: usize = 512 << 20;

/// Inputs of a target that are kept from run to run: each is tried at the beginning of every turn.
const MOST_GROWN: usize = 4000;

/// Bytes that they have at most, together.
const MOST_GROWN_BYTES: usize = 64 << 20;

/// Inputs after which branches are looked for where none was taken before.
const LOOK: usize = 32;

/// What the last panic said.
static PANIC: Mutex<String> = Mutex::new(String::new());

/// How many inputs were begun with.
static TAKEN: AtomicU64 = AtomicU64::new(0);

/// How many inputs this process has begun with.
pub fn taken() -> u64 {
    TAKEN.load(Ordering::Relaxed)
}

/// Keeps panics from the terminal, and what they say for findings. Once in a program.
pub fn quietly() {
    std::panic::set_hook(Box::new(|info| {
        let place = info.location().map(|l| format!("{}:{}", l.file(), l.line())).unwrap_or_default();
        let payload = info.payload();
        let text = payload.downcast_ref::<&str>().copied();
        let said = text.or_else(|| payload.downcast_ref::<String>().map(String::as_str)).unwrap_or("something");
        *PANIC.lock().unwrap_or_else(PoisonError::into_inner) = format!("panic at {place}: {said}");
    }));
}

/// An input at which a reader fails.
#[derive(Clone, Debug)]
pub struct Finding {
    /// What is wrong.
    pub what: String,
    /// The input, as small as it was made.
    pub input: Vec<u8>,
}

/// What a campaign came to.
#[derive(Clone, Debug, Default)]
pub struct Tally {
    /// Inputs that were tried.
    pub inputs: u64,
    /// Different things that the target said.
    pub said: usize,
    /// Branches that inputs took; `None` where the program does not count them.
    pub branches: Option<usize>,
    /// How long it took.
    pub time: Duration,
    /// The longest that an input took.
    pub slowest: Duration,
    /// The most memory that an input took.
    pub most_memory: usize,
    /// What was found, one of each kind.
    pub findings: Vec<Finding>,
}

/// A target that is fed.
pub struct Campaign<'a> {
    target: &'a Target,
    generator: Generator,
    random: Rng,
    /// Where each input is written before it is tried, for those that end the process.
    pub current: Option<PathBuf>,
    /// Where inputs that came to something new are kept from run to run.
    pub grown: Option<PathBuf>,
    /// How many more may be kept there, and how many bytes.
    room: [usize; 2],
    said: HashSet<String>,
    coverage: Coverage,
    /// Inputs since all counters were looked at.
    recent: Vec<Vec<u8>>,
    kinds: HashSet<String>,
    tally: Tally,
}

impl<'a> Campaign<'a> {
    /// With the kept corpus.
    pub fn new(target: &'a Target, seed: u64) -> Campaign<'a> {
        let files = corpus(target).into_iter().map(|(_, bytes)| bytes).collect();
        Campaign {
            target,
            generator: Generator::new(target, files),
            random: Rng::new(seed ^ target.name.bytes().fold(0, |h: u64, b| h.wrapping_mul(31).wrapping_add(b.into()))),
            current: None,
            grown: None,
            room: [0; 2],
            said: HashSet::new(),
            coverage: Coverage::of_program(),
            recent: Vec::new(),
            kinds: HashSet::new(),
            tally: Tally::default(),
        }
    }

    /// Tries the kept corpus, and then so many inputs, or until the time is over.
    pub fn run(mut self, inputs: u64, time: Duration) -> Tally {
        let start = Instant::now();
        for (_, bytes) in corpus(self.target) {
            let _new = self.take_wholly(&bytes);
        }
        self.room = [MOST_GROWN, MOST_GROWN_BYTES];
        // Short ones first: a longer one that comes to nothing more is not needed.
        for file in self.grown.as_deref().map(by_length).unwrap_or_default() {
            let Ok(input) = std::fs::read(&file) else { continue };
            let found = self.tally.findings.len();
            // Those that are new stay where they are; those that fail are told as findings.
            if !self.take_wholly(&input) && found == self.tally.findings.len() {
                let _still_there = std::fs::remove_file(file);
            }
        }
        // What the first one takes to begin with is not the input's.
        self.tally.most_memory = 0;
        while self.tally.inputs < inputs && start.elapsed() < time {
            let input = self.generator.next(&mut self.random);
            let _new = self.take(&input);
            self.look_around(input);
        }
        self.tally.said = self.said.len();
        self.tally.branches = self.coverage.counts().then(|| self.coverage.branches());
        self.tally.time = start.elapsed();
        self.tally
    }

    /// Now and then, where an input came to branches far from all others, has another look at each of the last ones.
    fn look_around(&mut self, input: Vec<u8>) {
        self.recent.push(input);
        if self.recent.len() == LOOK {
            let recent = std::mem::take(&mut self.recent);
            if self.coverage.elsewhere() {
                for input in &recent {
                    let _new = self.take(input);
                }
            }
        }
    }

    /// Keeps an input for later runs; they do without it if that fails.
    fn grow(&mut self, input: &[u8]) {
        let [inputs, bytes] = self.room;
        let Some(folder) = self.grown.as_ref().filter(|_| inputs > 0 && input.len() <= bytes) else { return };
        self.room = [inputs - 1, bytes - input.len()];
        let file = folder.join(format!("{:016x}", hash(input)));
        if !file.exists() {
            let _unwritten = std::fs::create_dir_all(folder).and_then(|()| std::fs::write(&file, input));
        }
    }

    /// Tries an input, and again where it came to branches far from all others; whether it came to something new.
    fn take_wholly(&mut self, input: &[u8]) -> bool {
        let new = self.take(input);
        if self.coverage.elsewhere() { self.take(input) } else { new }
    }

    /// Tries an input and takes note of what it came to; whether that is new.
    fn take(&mut self, input: &[u8]) -> bool {
        if let Some(file) = &self.current {
            // Without it, an input that ends the process is lost, and no more.
            let _unwritten = std::fs::write(file, input);
        }
        self.tally.inputs += 1;
        self.coverage.begin();
        let begun = Instant::now();
        let came = attempt(self.target, input);
        self.tally.slowest = self.tally.slowest.max(begun.elapsed());
        match came {
            Ok((said, memory)) => {
                self.tally.most_memory = self.tally.most_memory.max(memory);
                let words = self.said.insert(shape(&said));
                // Words may be new without end, as the names in them are.
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

/// The files in a folder, short ones first, and of one length in the order of names. They are not all in memory at once: some are large.
fn by_length(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut files: Vec<_> = entries.filter_map(|e| Some((e.metadata().ok()?.len(), e.path()))).collect();
    files.sort();
    files.into_iter().map(|(_, file)| file).collect()
}

/// Tries an input: what the target says, and the memory that it took; else what is wrong.
pub(crate) fn attempt(target: &Target, input: &[u8]) -> Result<(String, usize), String> {
    TAKEN.fetch_add(1, Ordering::Relaxed);
    let begun = count::begin();
    let said = catch_unwind(AssertUnwindSafe(|| (target.run)(input)));
    let memory = count::most(begun);
    let Ok(said) = said else {
        // What lies around the input may be half made.
        Place::forget();
        return Err(std::mem::take(&mut *PANIC.lock().unwrap_or_else(PoisonError::into_inner)));
    };
    // Some inputs are files of other sizes by the time they are read.
    let allowed = FREE + target.per_byte.saturating_mul(input.len()).min(MOST);
    match memory > allowed {
        true => Err(format!("memory: {memory} bytes for an input of {}", input.len())),
        false => Ok((said, memory)),
    }
}

/// What was said without numbers and names: the way through the reader that it stands for.
fn shape(said: &str) -> String {
    let mut quoted = false;
    let mut out = String::new();
    for c in said.chars() {
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

/// A name for an input (FNV-1a).
pub fn hash(input: &[u8]) -> u64 {
    input.iter().fold(0xcbf2_9ce4_8422_2325_u64, |h, b| (h ^ u64::from(*b)).wrapping_mul(0x100_0000_01b3))
}

/// By what findings count as one: where, or what.
fn kind(what: &str) -> String {
    what.split(": ").next().unwrap_or_default().to_owned()
}

/// The input with parts left out, as long as the same is wrong with it; within a few seconds.
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
