//! Reference of a recipe: executes its passes on the CPU in declared order.

use super::{Groups, Kind, Op, Recipe, Span};
use crate::kernels::mixed;

/// Invocations per workgroup of the kernels.
const GROUP: usize = 32;

/// Contents of every buffer.
pub struct Machine<'r> {
    recipe: &'r Recipe,
    /// Words of each buffer. Words of transients are `None` until a pass writes them.
    pub words: Vec<Vec<Option<u32>>>,
}

impl<'r> Machine<'r> {
    /// Returns the state before the first replay.
    pub fn new(recipe: &'r Recipe) -> Machine<'r> {
        let words =
            recipe.buffers.iter().enumerate().map(|(index, &(_, words))| {
                (0..words).map(|word| Some(Machine::initial(recipe, index, word))).collect()
            });
        Machine { recipe, words: words.collect() }
    }

    /// Returns the initial value of a word of a buffer.
    pub fn initial(recipe: &Recipe, buffer: usize, word: usize) -> u32 {
        mixed(recipe.seed ^ (buffer as u32) << 16, word as u32)
    }

    /// Returns the contents of the uniform in a replay.
    pub fn uniform(recipe: &Recipe, replay: u32) -> [u32; 4] {
        [0, 1, 2, 3].map(|word| mixed(recipe.seed.wrapping_add(word), replay + 1))
    }

    /// Runs one replay.
    pub fn replay(&mut self, replay: u32) {
        for (index, &(kind, _)) in self.recipe.buffers.iter().enumerate() {
            match kind {
                Kind::Transient | Kind::Retained => self.words[index].fill(None),
                Kind::Uniform => self.words[index] = Machine::uniform(self.recipe, replay).map(Some).to_vec(),
                Kind::External | Kind::Input => {}
            }
        }
        for op in &self.recipe.ops {
            self.run(op);
        }
    }

    fn read(&self, span: &Span) -> Vec<u32> {
        let words = &self.words[span.buffer][span.range()];
        words.iter().map(|word| word.unwrap_or_else(|| panic!("{span:?} is read and holds nothing"))).collect()
    }

    fn run(&mut self, op: &Op) {
        match op {
            Op::Fill(target, value) => self.words[target.buffer][target.range()].fill(Some(*value)),
            Op::Copy(source, target) => {
                let source = self.read(source);
                self.write(target, |i, _| Some(source[i]));
            }
            Op::Run { kernel, bound, seed, groups } => {
                let groups = match *groups {
                    Groups::Fixed(count) => count,
                    Groups::At(buffer, start) => self.read(&Span { buffer, start, words: 3 })[0],
                };
                if groups > 0 {
                    self.kernel(kernel, bound, *seed, groups);
                }
            }
        }
    }

    /// Writes a span from each word's position and old value; `None` keeps the old value.
    fn write(&mut self, span: &Span, value: impl Fn(usize, Option<u32>) -> Option<u32>) {
        for (i, word) in self.words[span.buffer][span.range()].iter_mut().enumerate() {
            *word = value(i, *word).or(*word);
        }
    }

    fn kernel(&mut self, name: &str, bound: &[(&'static str, Span, bool)], seed: u32, groups: u32) {
        let from = self.read(&bound[0].1);
        let (last, n) = (bound[bound.len() - 1].1, from.len());
        let at = |i: usize| from[i % n];
        let word = |i: usize| i as u32;
        match name {
            "map" => self.write(&last, |i, _| Some(mixed(at(i), seed.wrapping_add(word(i))))),
            "join" => {
                let right = self.read(&bound[1].1);
                let other = |i: usize| right[(word(i).wrapping_add(seed) as usize) % right.len()];
                self.write(&last, |i, _| Some(mixed(at(i).wrapping_add(seed), other(i))));
            }
            "part" => self.write(&last, |i, _| {
                let value = mixed(at(i), seed ^ word(i));
                (value & 3 != 0).then_some(value)
            }),
            "change" => self.write(&last, |i, old| Some(mixed(old?, at(i).wrapping_add(seed)))),
            "twice" => self.write(&last, |i, _| Some(mixed(at(i), seed).wrapping_mul(5).wrapping_add(1))),
            "sum" => {
                let sums = &mut self.words[last.buffer][last.range()];
                let count = sums.len();
                for (i, value) in from.iter().enumerate() {
                    let sum = &mut sums[mixed(word(i), seed) as usize % count];
                    *sum = sum.map(|sum| sum.wrapping_add(*value));
                }
            }
            "addend" => {
                let provided = self.read(&bound[1].1);
                self.write(&last, |i, _| Some(mixed(at(i), provided[i & 3].wrapping_add(seed))));
            }
            "counts" => self.write(&last, |i, _| match i {
                0 => Some(mixed(from[0], seed) & 3),
                1 | 2 => Some(1),
                _ => None,
            }),
            "grid" => {
                self.write(&last, |i, _| (i < GROUP * groups as usize).then(|| mixed(at(i), seed.wrapping_add(groups))))
            }
            other => panic!("no reference for kernel {other}"),
        }
    }
}
