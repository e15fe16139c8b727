//! Which passes go to a second queue, and where the queues wait for each other.
//!
//! One path of passes through the graph, the one that takes longest, stays on the main lane. Of the others, *excursions*
//! are gathered: passes that can all start when the main lane has finished some level, and of which it needs nothing
//! before a later one. An excursion pays if the two lanes end sooner than one would, by the costs that were given or are
//! guessed from bytes, and with what waiting costs. The last segment is the main lane's and waits for everything, so
//! that the end of a replay is one point.
//!
//! Images, buffers that others on the queue use, and whatever runs first stay on the main lane: layouts and seams with
//! others are its business.

use super::{CompileOptions, Group, Lane, Queues, Segment};
use crate::graph::pass::Pass;
use crate::graph::resource::{BufferInfo, BufferState};
use crate::shader::Access;
use std::collections::HashMap;

/// Bytes a nanosecond that a pass is guessed to move.
const BYTES_PER_NANOSECOND: u64 = 200;
/// What a pass is guessed to take at least.
const LAUNCH_NANOSECONDS: u64 = 2_000;

/// Nowhere but on the main lane.
const MAIN: usize = usize::MAX;

/// Passes of a second lane that belong together.
struct Excursion {
    passes: Vec<usize>,
    /// They may start when the main lane has finished the levels before this one.
    from: usize,
    /// The main lane needs them before this one.
    to: usize,
}

/// What the step works on.
struct Scene<'p> {
    passes: &'p [Pass],
    follows: &'p [Vec<u32>],
    level: Vec<usize>,
    cost: Vec<u64>,
    levels: &'p [Vec<usize>],
}

/// Groups and segments of both lanes, the groups in the order in which segments are submitted.
pub(super) fn lanes(
    buffers: &[BufferInfo],
    passes: &[Pass],
    follows: &[Vec<u32>],
    levels: Vec<Vec<usize>>,
    costs: &[(String, u64)],
    options: &CompileOptions,
) -> (Vec<Group>, Vec<Segment>) {
    let mut excursions = Vec::new();
    if options.queues != Queues::One && levels.len() > 2 {
        let scene = Scene::new(passes, follows, &levels, costs);
        excursions = scene.worthwhile(scene.excursions(buffers), options.queues);
    }
    emit(follows, &levels, &excursions)
}

impl<'p> Scene<'p> {
    fn new(
        passes: &'p [Pass],
        follows: &'p [Vec<u32>],
        levels: &'p [Vec<usize>],
        costs: &[(String, u64)],
    ) -> Scene<'p> {
        let mut level = vec![0; passes.len()];
        for (at, group) in levels.iter().enumerate() {
            group.iter().for_each(|&pass| level[pass] = at);
        }
        let given: HashMap<&str, u64> = costs.iter().map(|(name, cost)| (name.as_str(), *cost)).collect();
        let cost = passes.iter().map(|pass| given.get(pass.name.as_str()).copied().unwrap_or_else(|| guess(pass)));
        Scene { passes, follows, level, cost: cost.collect(), levels }
    }

    /// The path that takes longest; of equal ones, the one through the passes declared first.
    fn longest(&self) -> Vec<bool> {
        let mut end = vec![0; self.passes.len()];
        let mut last = None;
        for &pass in self.levels.iter().flatten() {
            let before = self.follows[pass].iter().map(|&before| end[before as usize]).max().unwrap_or(0);
            end[pass] = before + self.cost[pass];
            if last.is_none_or(|last: usize| (end[pass], last) > (end[last], pass)) {
                last = Some(pass);
            }
        }
        let mut on = vec![false; self.passes.len()];
        while let Some(pass) = last {
            on[pass] = true;
            last = self.follows[pass]
                .iter()
                .map(|&before| before as usize)
                .max_by_key(|&before| (end[before], std::cmp::Reverse(before)));
        }
        on
    }

    /// Every set of passes that could leave the main lane together.
    fn excursions(&self, buffers: &[BufferInfo]) -> Vec<Excursion> {
        let main = self.longest();
        let shared = |info: &BufferInfo| {
            info.image.is_some() || info.entry == BufferState::Queue || info.exit == BufferState::Queue
        };
        let mut found: Vec<Vec<usize>> = Vec::new();
        let mut of = vec![MAIN; self.passes.len()];
        for (at, group) in self.levels.iter().enumerate() {
            for &pass in group {
                let stays = self.passes[pass].accesses.iter().any(|(s, ..)| shared(&buffers[s.buffer.index()]));
                if main[pass] || stays || at == 0 {
                    continue;
                }
                // With the passes that it follows, if those are all together.
                let mut before = self.follows[pass].iter().map(|&before| of[before as usize]).filter(|&of| of != MAIN);
                let joins = before.next();
                if before.any(|other| Some(other) != joins) {
                    continue;
                }
                of[pass] = joins.unwrap_or(found.len());
                if of[pass] == found.len() {
                    found.push(Vec::new());
                }
                found[of[pass]].push(pass);
            }
        }
        // What does not fit goes back to the main lane, which changes what fits: until all that is left does.
        loop {
            let windows = self.windows(&of, found.len());
            let Some(wrong) = (0..found.len()).find(|&at| !found[at].is_empty() && windows[at].is_none()) else {
                let fits = found.into_iter().zip(windows);
                return fits
                    .filter_map(|(passes, window)| window.map(|(from, to)| Excursion { passes, from, to }))
                    .filter(|excursion| !excursion.passes.is_empty())
                    .collect();
            };
            // Only the last pass at first: a shorter excursion may still fit.
            if let Some(pass) = found[wrong].pop() {
                of[pass] = MAIN;
            }
        }
    }

    /// By excursion: from which level to which it can be away, if at all.
    fn windows(&self, of: &[usize], count: usize) -> Vec<Option<(usize, usize)>> {
        let mut windows = vec![Some((1, self.levels.len())); count];
        for &pass in self.levels.iter().flatten() {
            for before in self.follows[pass].iter().map(|&before| before as usize) {
                match (of[before], of[pass]) {
                    (first, second) if first == second => {}
                    (MAIN, second) => {
                        if let Some((from, _)) = &mut windows[second] {
                            *from = (*from).max(self.level[before] + 1);
                        }
                    }
                    (first, MAIN) => {
                        if let Some((_, to)) = &mut windows[first] {
                            *to = (*to).min(self.level[pass]);
                        }
                    }
                    // One after the other without the main lane in between: the later one stays.
                    (_, second) => windows[second] = None,
                }
            }
        }
        // There must be something on the main lane in the meantime.
        let busy = |from: usize, to: usize| {
            self.levels.get(from..to).is_some_and(|levels| levels.iter().flatten().any(|&pass| of[pass] == MAIN))
        };
        windows.into_iter().map(|window| window.filter(|&(from, to)| from < to && busy(from, to))).collect()
    }

    /// Those that pay, the costliest first in line.
    fn worthwhile(&self, mut all: Vec<Excursion>, queues: Queues) -> Vec<Excursion> {
        let (percent, wait) = match queues {
            Queues::One => return Vec::new(),
            Queues::Forced => return all,
            Queues::Two { gain_percent, wait_nanoseconds } => (u64::from(gain_percent), u64::from(wait_nanoseconds)),
        };
        let work = |excursion: &Excursion| -> u64 { excursion.passes.iter().map(|&pass| self.cost[pass]).sum() };
        all.sort_by_key(|excursion| (std::cmp::Reverse(work(excursion)), excursion.passes[0]));
        let alone = self.duration(&[], wait);
        let mut taken: Vec<Excursion> = Vec::new();
        let mut best = alone;
        for excursion in all {
            taken.push(excursion);
            let with = self.duration(&taken, wait);
            if with < best {
                best = with;
            } else {
                taken.pop();
            }
        }
        if (alone - best) * 100 < alone * percent { Vec::new() } else { taken }
    }

    /// How long a replay takes: passes of one group run at once, groups one after the other.
    fn duration(&self, excursions: &[Excursion], wait: u64) -> u64 {
        let mut of = vec![MAIN; self.passes.len()];
        for (at, excursion) in excursions.iter().enumerate() {
            excursion.passes.iter().for_each(|&pass| of[pass] = at);
        }
        let (mut main, mut side) = (0, 0);
        let mut ends = vec![0; excursions.len()];
        for at in 0..=self.levels.len() {
            for (end, _) in ends.iter().zip(excursions).filter(|(_, excursion)| excursion.to == at) {
                main = main.max(*end + wait);
            }
            for (number, excursion) in excursions.iter().enumerate().filter(|(_, excursion)| excursion.from == at) {
                side = side.max(main + wait);
                let longest = |group: &Vec<usize>| group.iter().map(|&pass| self.cost[pass]).max().unwrap_or(0);
                side += depths(self.follows, &excursion.passes).iter().map(longest).sum::<u64>();
                ends[number] = side;
            }
            let level = self.levels.get(at).into_iter().flatten().filter(|&&pass| of[pass] == MAIN);
            main += level.map(|&pass| self.cost[pass]).max().unwrap_or(0);
        }
        main
    }
}

/// What a pass may take, by the bytes that it touches.
fn guess(pass: &Pass) -> u64 {
    let moved = |access: &Access| if *access == Access::Read || *access == Access::Write { 1 } else { 2 };
    let bytes: u64 = pass.accesses.iter().map(|(slice, access, _)| slice.bytes.saturating_mul(moved(access))).sum();
    LAUNCH_NANOSECONDS + bytes / BYTES_PER_NANOSECOND
}

/// Passes in groups of their own, by how many of them each one follows in a row.
fn depths(follows: &[Vec<u32>], passes: &[usize]) -> Vec<Vec<usize>> {
    let mut depth: HashMap<usize, usize> = HashMap::new();
    let mut groups: Vec<Vec<usize>> = Vec::new();
    for &pass in passes {
        let before = follows[pass].iter().filter_map(|before| depth.get(&(*before as usize)));
        let at = before.max().map_or(0, |depth| depth + 1);
        depth.insert(pass, at);
        if groups.len() == at {
            groups.push(Vec::new());
        }
        groups[at].push(pass);
    }
    groups
}

/// Lays both lanes out.
fn emit(follows: &[Vec<u32>], levels: &[Vec<usize>], excursions: &[Excursion]) -> (Vec<Group>, Vec<Segment>) {
    let away: std::collections::HashSet<usize> = excursions.iter().flat_map(|e| e.passes.iter().copied()).collect();
    let mut groups: Vec<Group> = Vec::new();
    let mut segments: Vec<Segment> = Vec::new();
    let mut number = vec![0; excursions.len()];
    // Where the open segment of the main lane begins, and what it waits for.
    let (mut open, mut waits, mut waited) = (0, Vec::new(), None);
    for at in 0..=levels.len() {
        let ends: Vec<usize> = (0..excursions.len()).filter(|&e| excursions[e].to == at).collect();
        let starts: Vec<usize> = (0..excursions.len()).filter(|&e| excursions[e].from == at).collect();
        if !(ends.is_empty() && starts.is_empty()) && (groups.len() > open || !waits.is_empty()) {
            let waits = std::mem::take(&mut waits);
            segments.push(Segment { lane: Lane::Main, groups: open..groups.len(), waits, last: None });
        }
        let last_main = segments.iter().rposition(|segment| segment.lane == Lane::Main);
        for start in starts {
            let first = groups.len();
            let own = depths(follows, &excursions[start].passes);
            groups.extend(own.into_iter().map(|passes| Group { barrier: None, passes }));
            number[start] = segments.len();
            let waits = last_main.into_iter().collect();
            segments.push(Segment { lane: Lane::Side, groups: first..groups.len(), waits, last: Some(super::RESULTS) });
        }
        if segments.last().is_some_and(|segment| segment.groups.end == groups.len()) {
            open = groups.len();
        }
        // The latest stands for all before it on its lane.
        let end = ends.into_iter().map(|end| number[end]).max().filter(|&end| waited.is_none_or(|waited| end > waited));
        waited = waited.max(end);
        waits.extend(end);
        let stay: Vec<usize> = levels.get(at).into_iter().flatten().copied().filter(|p| !away.contains(p)).collect();
        if !stay.is_empty() {
            groups.push(Group { barrier: None, passes: stay });
        }
    }
    segments.push(Segment { lane: Lane::Main, groups: open..groups.len(), waits, last: None });
    (groups, segments)
}

/// By group: the first and the last position in the list of groups at which something may run together with it.
pub(super) fn spans(groups: usize, segments: &[Segment]) -> Vec<(usize, usize)> {
    let mut spans: Vec<(usize, usize)> = (0..groups).map(|at| (at, at)).collect();
    for (number, segment) in segments.iter().enumerate().filter(|(_, segment)| segment.lane == Lane::Side) {
        // Who waits for this one or a later one of its lane has waited for it.
        let waits = |later: &&Segment| later.lane == Lane::Main && later.waits.iter().any(|&wait| wait >= number);
        let end = segments[number..].iter().find(waits).map_or(groups, |later| later.groups.start);
        for at in segment.groups.clone() {
            spans[at] = (segment.groups.start, end.saturating_sub(1).max(at));
        }
    }
    spans
}
