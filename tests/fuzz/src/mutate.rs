//! Mutations of inputs: small ones that keep most of a file, and large ones.

use crate::target::Target;

/// Random generator (SplitMix64).
#[derive(Clone, Debug)]
pub struct Rng(u64);

impl Rng {
    /// Creates a generator from a seed.
    pub fn new(seed: u64) -> Rng {
        Rng(seed)
    }

    /// Draws 64 random bits.
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Draws a number below `n`; returns 0 if `n` is 0.
    pub fn below(&mut self, n: usize) -> usize {
        if n == 0 { 0 } else { (self.bits() % n as u64) as usize }
    }

    /// Draws true with probability 1/`n`.
    pub fn once_in(&mut self, n: usize) -> bool {
        self.below(n) == 0
    }

    fn pick<'a, T>(&mut self, all: &'a [T]) -> Option<&'a T> {
        all.get(self.below(all.len()))
    }
}

/// Boundary values, at which readers tend to fail.
const EDGES: [u64; 22] = [
    0,
    1,
    2,
    3,
    7,
    8,
    15,
    16,
    31,
    127,
    128,
    255,
    256,
    32_767,
    65_535,
    65_536,
    0x7fff_ffff,
    0x8000_0000,
    0xffff_ffff,
    0x1_0000_0000,
    i64::MAX as u64,
    u64::MAX,
];

/// Generator of inputs from a corpus.
pub struct Generator {
    words: Vec<&'static [u8]>,
    fix: Option<crate::fix::Fix>,
    longest: usize,
    corpus: Vec<Vec<u8>>,
    /// Number of initial inputs.
    initial: usize,
    /// Number of bytes that may still be added.
    room: usize,
}

/// Maximum number of inputs that are added.
const MOST_ADDED: usize = 4000;

/// Maximum number of bytes that are added: the fuzzer shares its memory with the readers.
const MOST_BYTES: usize = 256 << 20;

/// Maximum growth of most inputs, in bytes.
const SHORT: usize = 1 << 10;

/// Number of recent inputs that are preferred.
const LAST: usize = 32;

impl Generator {
    /// Creates a generator for a target with these files and an empty file.
    pub fn new(target: &Target, mut corpus: Vec<Vec<u8>>) -> Generator {
        corpus.retain(|file| !file.is_empty());
        let longest = corpus.iter().map(|file| 2 * file.len()).max().unwrap_or(0).max(1 << 16);
        corpus.push(Vec::new());
        let words = target.words.iter().flat_map(|w| w.list().iter().copied()).collect();
        Generator { words, fix: target.fix, longest, initial: corpus.len(), room: MOST_BYTES, corpus }
    }

    /// Adds an input with a new result.
    pub fn keep(&mut self, input: &[u8]) {
        if self.corpus.len() < self.initial + MOST_ADDED && input.len() <= self.room {
            self.room -= input.len();
            self.corpus.push(input.to_vec());
        }
    }

    /// Returns the number of inputs in the corpus.
    pub fn len(&self) -> usize {
        self.corpus.len()
    }

    /// Returns true if the corpus is empty, which never happens.
    pub fn is_empty(&self) -> bool {
        self.corpus.is_empty()
    }

    /// Returns a mutated input.
    pub fn next(&self, random: &mut Rng) -> Vec<u8> {
        // Initial files keep the inputs close to valid ones; the most recent inputs lead on from new results.
        let (all, last) = (self.corpus.len(), self.corpus.len().min(LAST));
        let from = match random.below(4) {
            0 => random.below(self.initial),
            1 => all - 1 - random.below(last),
            _ => random.below(all),
        };
        let mut input = self.corpus[from].clone();
        // Long inputs take long, so they are rare.
        let longest = if random.once_in(8) { self.longest } else { self.longest.min(input.len() + SHORT) };
        let most = 1 << random.below(5);
        let changes = 1 + random.below(most);
        for _ in 0..changes {
            self.change(&mut input, random);
            input.truncate(longest);
        }
        if let Some(fix) = self.fix
            && !random.once_in(4)
        {
            fix(&mut input);
        }
        input
    }

    /// Applies one mutation.
    fn change(&self, b: &mut Vec<u8>, r: &mut Rng) {
        match r.below(18) {
            0 => at(b, r, 1, |part, r| part[0] ^= 1 << r.below(8)),
            1 => at(b, r, 1, |part, r| part[0] = r.bits() as u8),
            2 | 3 => {
                let width = 1 << r.below(4);
                at(b, r, width, |part, r| number(part, EDGES[r.below(EDGES.len())], r));
            }
            4 => {
                let width = 1 << r.below(4);
                at(b, r, width, |part, r| {
                    let mut word = [0; 8];
                    word[..part.len()].copy_from_slice(part);
                    let by = r.below(33) as u64;
                    number(part, u64::from_le_bytes(word).wrapping_add(by).wrapping_sub(16), r);
                });
            }
            5 => b.truncate(place(b, r)),
            6 => drop(b.drain(range(b, r))),
            7 => {
                let part = b[range(b, r)].to_vec();
                insert(b, place(b, r), &part);
            }
            8 if r.once_in(8) => {
                // Creates deep nesting or many items.
                let span = range(b, r);
                let part = b[span.start..span.end.min(span.start + 1 + r.below(24))].to_vec();
                let times = (1 << r.below(15)).min((1 << 16) / part.len().max(1));
                insert(b, place(b, r), &part.repeat(times));
            }
            8 | 9 => {
                let word = self.word(r);
                insert(b, place(b, r), &word);
            }
            10 => {
                let word = self.word(r);
                at(b, r, word.len(), |part, _| part.copy_from_slice(&word));
            }
            11 => {
                let Some(other) = r.pick(&self.corpus) else { return };
                let (here, there) = (place(b, r), place(other, r));
                b.truncate(here);
                b.extend(&other[there..]);
            }
            12 => {
                let Some(other) = r.pick(&self.corpus) else { return };
                let part = other[range(other, r)].to_vec();
                insert(b, place(b, r), &part);
            }
            13 | 14 => self.replace_number(b, r),
            15 => self.replace_text(b, r),
            16 => {
                let (from, to) = (range(b, r), place(b, r));
                let part: Vec<u8> = b.drain(from).collect();
                let to = to.min(b.len());
                insert(b, to, &part);
            }
            _ => {
                let random: Vec<u8> = (0..1 + r.below(8)).map(|_| r.bits() as u8).collect();
                insert(b, place(b, r), &random);
            }
        }
    }

    fn word(&self, r: &mut Rng) -> Vec<u8> {
        r.pick(&self.words).map_or_else(|| vec![0; 4], |w| w.to_vec())
    }

    /// Replaces a number in text.
    fn replace_number(&self, b: &mut Vec<u8>, r: &mut Rng) {
        let start = place(b, r);
        let part = |c: &u8| c.is_ascii_digit() || matches!(c, b'.' | b'-' | b'+' | b'e' | b'E');
        let Some(from) = b[start..].iter().position(u8::is_ascii_digit).map(|at| start + at) else { return };
        let from = from - usize::from(from > 0 && b[from - 1] == b'-');
        let to = b[from..].iter().position(|c| !part(c)).map_or(b.len(), |n| from + n);
        let numbers = crate::Words::Numbers.list();
        let new = numbers[r.below(numbers.len())];
        b.splice(from..to, new.iter().copied());
    }

    /// Replaces a quoted text by another quoted text of the file, or by a word.
    fn replace_text(&self, b: &mut Vec<u8>, r: &mut Rng) {
        let quoted = |b: &[u8], start: usize| {
            let from = b[start..].iter().position(|c| *c == b'"').map(|n| start + n)?;
            let to = b[from + 1..].iter().position(|c| *c == b'"').map(|n| from + n + 2)?;
            Some(from..to)
        };
        let Some(span) = quoted(b, place(b, r)) else { return };
        let new = match quoted(b, place(b, r)) {
            Some(other) if !r.once_in(3) => b[other].to_vec(),
            _ => self.word(r),
        };
        b.splice(span, new);
    }
}

/// Draws a position in a file, or its end; positions near the start are more likely.
fn place(b: &[u8], r: &mut Rng) -> usize {
    if r.once_in(2) { r.below(b.len().min(600) + 1) } else { r.below(b.len() + 1) }
}

/// Draws a range of a file, mostly a short one.
fn range(b: &[u8], r: &mut Rng) -> std::ops::Range<usize> {
    let from = place(b, r);
    let longest = if r.once_in(4) { b.len() } else { 32 };
    from..(from + r.below(longest + 1)).min(b.len())
}

/// Changes `width` bytes at a random position, if the file is long enough.
fn at(b: &mut [u8], r: &mut Rng, width: usize, change: impl FnOnce(&mut [u8], &mut Rng)) {
    if width > 0 && b.len() >= width {
        let from = place(b, r).min(b.len() - width);
        change(&mut b[from..from + width], r);
    }
}

/// Writes a number in little-endian or big-endian order.
fn number(part: &mut [u8], value: u64, r: &mut Rng) {
    let bytes = value.to_le_bytes();
    let width = part.len();
    part.copy_from_slice(&bytes[..width]);
    if r.once_in(2) {
        part.reverse();
    }
}

fn insert(b: &mut Vec<u8>, at: usize, part: &[u8]) {
    b.splice(at..at, part.iter().copied());
}
