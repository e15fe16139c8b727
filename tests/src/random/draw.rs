//! Drawing of a recipe: random passes, and a record of the words with defined contents.

use super::{Groups, Kind, Op, Recipe, Span};
use sgs_engine::graph::CompileOptions;
use sgs_passes::reference::rng::Pcg;

/// Draws a recipe from a seed.
///
/// `alignment`: required multiple of the offsets of bindings, in bytes; values below 16 count as 16.
pub fn draw(seed: u32, alignment: u64) -> Recipe {
    let mut d = Draw::new(seed, alignment);
    let passes = 4 + d.below(28);
    let mut ops = Vec::new();
    // A drawn pass may not fit the buffers; then another pass is drawn.
    for _ in 0..20 * passes {
        if ops.len() == passes {
            break;
        }
        if let Some(op) = d.op() {
            d.record(&op);
            ops.push(op);
        }
    }
    let odds = |d: &mut Draw, of: usize| d.below(of) != 0;
    Recipe {
        seed,
        ops,
        options: CompileOptions {
            alignment: alignment.max(16),
            alias: odds(&mut d, 6),
            reorder: odds(&mut d, 6),
            verify: true,
        },
        replays: 1 + d.below(4) as u32,
        frames: 1 + d.below(3),
        poison: d.below(2) == 0,
        buffers: d.buffers,
    }
}

struct Draw {
    rng: Pcg,
    /// Alignment of the starts of bound spans, in words.
    step: usize,
    buffers: Vec<(Kind, usize)>,
    /// Whether each word of each buffer has defined contents.
    defined: Vec<Vec<bool>>,
    /// Group counts: pairs of a buffer and the first of three words.
    counts: Vec<(usize, usize)>,
}

impl Draw {
    fn new(seed: u32, alignment: u64) -> Draw {
        let step = (alignment.max(16) / 4) as usize;
        let mut d = Draw { rng: Pcg::new(seed), step, buffers: Vec::new(), defined: Vec::new(), counts: Vec::new() };
        d.buffers = vec![(Kind::External, 40 * step), (Kind::Input, 16 * step), (Kind::Uniform, 4)];
        for _ in 0..4 + d.below(10) {
            let kind = [Kind::External, Kind::Retained, Kind::Transient, Kind::Transient, Kind::Transient][d.below(5)];
            // Some buffers end in the middle of a step.
            let words = step * (1 + d.below(12)) + d.below(step);
            d.buffers.push((kind, words));
        }
        d.defined = d.buffers.iter().map(|&(kind, words)| vec![!kind.transient(); words]).collect();
        d
    }

    fn below(&mut self, count: usize) -> usize {
        self.rng.next_u32() as usize % count.max(1)
    }

    /// Draws words of a random buffer.
    ///
    /// `bound`: whether the start is aligned for bindings; transfers take any word.
    fn span(&mut self, bound: bool) -> Span {
        let buffer = self.below(self.buffers.len());
        let words = self.buffers[buffer].1;
        let step = if bound { self.step } else { 1 };
        let start = if self.below(3) == 0 { 0 } else { self.below(words.div_ceil(step)) * step };
        let most = words - start;
        let words = if self.below(3) == 0 { most } else { 1 + self.below(most) };
        Span { buffer, start, words }
    }

    fn holds(&self, span: &Span) -> bool {
        self.defined[span.buffer][span.range()].iter().all(|&defined| defined)
    }

    fn readable(&mut self, bound: bool) -> Option<Span> {
        self.find(bound, |draw, s| draw.buffers[s.buffer].0 != Kind::Uniform && draw.holds(s))
    }

    /// Draws a writable span; `whole` requires defined contents.
    fn writable(&mut self, bound: bool, whole: bool) -> Option<Span> {
        self.find(bound, |draw, s| draw.buffers[s.buffer].0.writable() && (!whole || draw.holds(s)))
    }

    /// Draws spans until one suits, at most 12 times.
    fn find(&mut self, bound: bool, suits: impl Fn(&Draw, &Span) -> bool) -> Option<Span> {
        for _ in 0..12 {
            let span = self.span(bound);
            if suits(self, &span) {
                return Some(span);
            }
        }
        None
    }

    fn op(&mut self) -> Option<Op> {
        let seed = self.rng.next_u32();
        match self.below(16) {
            0 | 1 => Some(Op::Fill(self.writable(false, false)?, seed % 7)),
            2 => {
                let (mut from, mut to) = (self.readable(false)?, self.writable(false, false)?);
                let words = from.words.min(to.words);
                (from.words, to.words) = (words, words);
                (!from.overlaps(&to)).then_some(Op::Copy(from, to))
            }
            3 | 4 => {
                let mut to = self.writable(true, false)?;
                to.words = to.words.max(3);
                if to.range().end > self.buffers[to.buffer].1 {
                    return None;
                }
                let from = self.readable(true)?;
                self.run("counts", vec![("from", from, false), ("groups", to, false)], seed, false)
            }
            kind => {
                // The device may count zero groups. Then the pass writes nothing, so the target must be defined before.
                let indirect = !self.counts.is_empty() && (kind == 5 || self.below(4) == 0);
                let (kernel, target) = [
                    ("grid", "to"),
                    ("map", "to"),
                    ("map", "to"),
                    ("join", "to"),
                    ("part", "to"),
                    ("change", "words"),
                    ("twice", "words"),
                    ("sum", "sums"),
                    ("sum", "sums"),
                    ("sum", "sums"),
                    ("addend", "to"),
                ][kind - 5];
                let partial = indirect || matches!(kernel, "grid" | "part" | "change" | "sum");
                let to = self.writable(true, partial)?;
                // A read-write binding of a target without defined contents has to be declared as discarded.
                let must = kernel == "twice" && !self.holds(&to);
                let discard = must || !partial && self.below(3) == 0;
                let mut bound = match kernel {
                    "join" => vec![("left", self.readable(true)?, false), ("right", self.readable(true)?, false)],
                    _ => vec![("from", self.readable(true)?, false)],
                };
                if kernel == "addend" {
                    bound.push(("addend", Span { buffer: 2, start: 0, words: 4 }, false));
                }
                bound.push((target, to, discard));
                self.run(kernel, bound, seed, indirect)
            }
        }
    }

    fn run(
        &mut self,
        kernel: &'static str,
        bound: Vec<(&'static str, Span, bool)>,
        seed: u32,
        indirect: bool,
    ) -> Option<Op> {
        let written = bound.last()?.1;
        if bound[..bound.len() - 1].iter().any(|(_, span, _)| span.overlaps(&written)) {
            return None;
        }
        let groups = if indirect {
            let (buffer, word) = {
                let at = self.below(self.counts.len());
                self.counts[at]
            };
            if (Span { buffer, start: word, words: 3 }).overlaps(&written) {
                return None;
            }
            Groups::At(buffer, word)
        } else {
            Groups::Fixed(1 + self.below(3) as u32)
        };
        Some(Op::Run { kernel, bound, seed, groups })
    }

    /// Records the words that the pass defines and its group counts.
    fn record(&mut self, op: &Op) {
        let (written, sure) = match op {
            Op::Fill(target, _) | Op::Copy(_, target) => (*target, target.words),
            Op::Run { kernel: "counts", bound, .. } => (bound[1].1, 3),
            Op::Run { bound, .. } => (bound[bound.len() - 1].1, bound[bound.len() - 1].1.words),
        };
        self.counts.retain(|&(buffer, word)| !Span { buffer, start: word, words: 3 }.overlaps(&written));
        // Passes that may leave words unchanged get only targets that are defined everywhere.
        self.defined[written.buffer][written.start..written.start + sure].fill(true);
        if matches!(op, Op::Run { kernel: "counts", .. }) {
            self.counts.push((written.buffer, written.start));
        }
    }
}
