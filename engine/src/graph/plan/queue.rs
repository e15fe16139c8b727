//! Assignment of passes to two queues, and the waits between them.
//!
//! The longest path through the graph stays on the main lane. *Excursions* are gathered from the other passes: passes
//! that can all start once the main lane has finished some level, and that it does not need before a later level. An
//! excursion is used if the two lanes then end sooner than one, by known costs or estimates from bytes, including the
//! cost of waits. The last segment belongs to the main lane and waits for everything, so that a replay ends at one
//! point.
//!
//! Images, buffers shared with the queue, and the passes of the first level stay on the main lane, which handles
//! layouts and external commands.

use super::{CompileOptions, Group, Lane, Queues, Segment};
use crate::graph::pass::Pass;
use crate::graph::resource::{BufferInfo, BufferState};
use crate::shader::Access;
use std::collections::HashMap;

/// Estimated memory throughput of a pass in bytes per nanosecond.
const BYTES_PER_NANOSECOND: u64 = 200;
/// Estimated minimum duration of a pass.
const LAUNCH_NANOSECONDS: u64 = 2_000;

/// Marks passes of the main lane.
const MAIN: usize = usize::MAX;

/// Passes that run together on the second lane.
struct Excursion {
    passes: Vec<usize>,
    /// First level that they may run beside; the main lane must have finished all earlier ones.
    from: usize,
    /// Level before which the main lane needs them.
    to: usize,
}

/// Inputs of lane assignment.
struct LaneInputs<'p> {
    passes: &'p [Pass],
    dependencies: &'p [Vec<u32>],
    level: Vec<usize>,
    cost: Vec<u64>,
    levels: &'p [Vec<usize>],
}

/// Returns groups and segments of both lanes, with groups in submission order of the segments.
pub(super) fn lanes(
    buffers: &[BufferInfo],
    passes: &[Pass],
    dependencies: &[Vec<u32>],
    levels: Vec<Vec<usize>>,
    costs: &[(String, u64)],
    options: &CompileOptions,
) -> (Vec<Group>, Vec<Segment>) {
    let mut excursions = Vec::new();
    if options.queues != Queues::One && levels.len() > 2 {
        let inputs = LaneInputs::new(passes, dependencies, &levels, costs);
        excursions = inputs.profitable(inputs.excursions(buffers), options.queues);
    }
    emit(dependencies, &levels, &excursions)
}

impl<'p> LaneInputs<'p> {
    fn new(
        passes: &'p [Pass],
        dependencies: &'p [Vec<u32>],
        levels: &'p [Vec<usize>],
        costs: &[(String, u64)],
    ) -> LaneInputs<'p> {
        let mut level = vec![0; passes.len()];
        for (at, group) in levels.iter().enumerate() {
            group.iter().for_each(|&pass| level[pass] = at);
        }
        let known_costs: HashMap<&str, u64> = costs.iter().map(|(name, cost)| (name.as_str(), *cost)).collect();
        let cost =
            passes.iter().map(|pass| known_costs.get(pass.name.as_str()).copied().unwrap_or_else(|| guess(pass)));
        LaneInputs { passes, dependencies, level, cost: cost.collect(), levels }
    }

    /// Returns the passes of the longest path; among equals, of the path through the passes declared first.
    fn longest(&self) -> Vec<bool> {
        let mut end = vec![0; self.passes.len()];
        let mut last = None;
        for &pass in self.levels.iter().flatten() {
            let before = self.dependencies[pass].iter().map(|&before| end[before as usize]).max().unwrap_or(0);
            end[pass] = before + self.cost[pass];
            if last.is_none_or(|last: usize| (end[pass], last) > (end[last], pass)) {
                last = Some(pass);
            }
        }
        let mut on = vec![false; self.passes.len()];
        while let Some(pass) = last {
            on[pass] = true;
            last = self.dependencies[pass]
                .iter()
                .map(|&before| before as usize)
                .max_by_key(|&before| (end[before], std::cmp::Reverse(before)));
        }
        on
    }

    /// Returns all sets of passes that could leave the main lane together.
    fn excursions(&self, buffers: &[BufferInfo]) -> Vec<Excursion> {
        let main = self.longest();
        let shared = |info: &BufferInfo| {
            info.image.is_some() || info.entry == BufferState::Queue || info.exit == BufferState::Queue
        };
        let mut found: Vec<Vec<usize>> = Vec::new();
        let mut excursion_of = vec![MAIN; self.passes.len()];
        for (at, group) in self.levels.iter().enumerate() {
            for &pass in group {
                let on_main = self.passes[pass].accesses.iter().any(|(s, ..)| shared(&buffers[s.buffer.index()]));
                if main[pass] || on_main || at == 0 {
                    continue;
                }
                // Joins the excursion of the passes that it depends on, if those are all in one.
                let mut before = self.dependencies[pass]
                    .iter()
                    .map(|&before| excursion_of[before as usize])
                    .filter(|&excursion_of| excursion_of != MAIN);
                let joins = before.next();
                if before.any(|other| Some(other) != joins) {
                    continue;
                }
                excursion_of[pass] = joins.unwrap_or(found.len());
                if excursion_of[pass] == found.len() {
                    found.push(Vec::new());
                }
                found[excursion_of[pass]].push(pass);
            }
        }
        // Passes that do not fit return to the main lane, which changes what fits; repeats until all others fit.
        loop {
            let windows = self.windows(&excursion_of, found.len());
            let Some(wrong) = (0..found.len()).find(|&at| !found[at].is_empty() && windows[at].is_none()) else {
                let fits = found.into_iter().zip(windows);
                return fits
                    .filter_map(|(passes, window)| window.map(|(from, to)| Excursion { passes, from, to }))
                    .filter(|excursion| !excursion.passes.is_empty())
                    .collect();
            };
            // Removes only the last pass: a shorter excursion may still fit.
            if let Some(pass) = found[wrong].pop() {
                excursion_of[pass] = MAIN;
            }
        }
    }

    /// Returns, by excursion, the level range in which it can run beside the main lane, if any.
    fn windows(&self, excursion_of: &[usize], count: usize) -> Vec<Option<(usize, usize)>> {
        let mut windows = vec![Some((1, self.levels.len())); count];
        for &pass in self.levels.iter().flatten() {
            for before in self.dependencies[pass].iter().map(|&before| before as usize) {
                match (excursion_of[before], excursion_of[pass]) {
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
                    // Two excursions without the main lane in between: the later one stays.
                    (_, second) => windows[second] = None,
                }
            }
        }
        // The main lane must run something in the meantime.
        let busy = |from: usize, to: usize| {
            self.levels
                .get(from..to)
                .is_some_and(|levels| levels.iter().flatten().any(|&pass| excursion_of[pass] == MAIN))
        };
        windows.into_iter().map(|window| window.filter(|&(from, to)| from < to && busy(from, to))).collect()
    }

    /// Returns the excursions that shorten a replay, considered by descending cost.
    fn profitable(&self, mut all: Vec<Excursion>, queues: Queues) -> Vec<Excursion> {
        let (percent, wait) = match queues {
            Queues::One => return Vec::new(),
            Queues::Forced => return all,
            Queues::Two { gain_percent, wait_nanoseconds } => (u64::from(gain_percent), u64::from(wait_nanoseconds)),
        };
        let work = |excursion: &Excursion| -> u64 { excursion.passes.iter().map(|&pass| self.cost[pass]).sum() };
        all.sort_by_key(|excursion| (std::cmp::Reverse(work(excursion)), excursion.passes[0]));
        let single_queue = self.duration(&[], wait);
        let mut selected: Vec<Excursion> = Vec::new();
        let mut best = single_queue;
        for excursion in all {
            selected.push(excursion);
            let with = self.duration(&selected, wait);
            if with < best {
                best = with;
            } else {
                selected.pop();
            }
        }
        if (single_queue - best) * 100 < single_queue * percent { Vec::new() } else { selected }
    }

    /// Estimates the duration of a replay: passes of one group run concurrently, groups in sequence.
    fn duration(&self, excursions: &[Excursion], wait: u64) -> u64 {
        let mut excursion_of = vec![MAIN; self.passes.len()];
        for (at, excursion) in excursions.iter().enumerate() {
            excursion.passes.iter().for_each(|&pass| excursion_of[pass] = at);
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
                side += depths(self.dependencies, &excursion.passes).iter().map(longest).sum::<u64>();
                ends[number] = side;
            }
            let level = self.levels.get(at).into_iter().flatten().filter(|&&pass| excursion_of[pass] == MAIN);
            main += level.map(|&pass| self.cost[pass]).max().unwrap_or(0);
        }
        main
    }
}

/// Estimates the duration of a pass from the bytes that it accesses.
fn guess(pass: &Pass) -> u64 {
    let moved = |access: &Access| if *access == Access::Read || *access == Access::Write { 1 } else { 2 };
    let bytes: u64 = pass.accesses.iter().map(|(slice, access, _)| slice.bytes.saturating_mul(moved(access))).sum();
    LAUNCH_NANOSECONDS + bytes / BYTES_PER_NANOSECOND
}

/// Groups passes by their depth in the dependency chain among them.
fn depths(dependencies: &[Vec<u32>], passes: &[usize]) -> Vec<Vec<usize>> {
    let mut depth: HashMap<usize, usize> = HashMap::new();
    let mut groups: Vec<Vec<usize>> = Vec::new();
    for &pass in passes {
        let before = dependencies[pass].iter().filter_map(|before| depth.get(&(*before as usize)));
        let at = before.max().map_or(0, |depth| depth + 1);
        depth.insert(pass, at);
        if groups.len() == at {
            groups.push(Vec::new());
        }
        groups[at].push(pass);
    }
    groups
}

/// Builds groups and segments of both lanes.
fn emit(dependencies: &[Vec<u32>], levels: &[Vec<usize>], excursions: &[Excursion]) -> (Vec<Group>, Vec<Segment>) {
    let on_side: std::collections::HashSet<usize> = excursions.iter().flat_map(|e| e.passes.iter().copied()).collect();
    let mut groups: Vec<Group> = Vec::new();
    let mut segments: Vec<Segment> = Vec::new();
    let mut number = vec![0; excursions.len()];
    // Start of the open segment of the main lane, and its waits.
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
            let own = depths(dependencies, &excursions[start].passes);
            groups.extend(own.into_iter().map(|passes| Group { barrier: None, passes }));
            number[start] = segments.len();
            let waits = last_main.into_iter().collect();
            segments.push(Segment { lane: Lane::Side, groups: first..groups.len(), waits, last: Some(super::RESULTS) });
        }
        if segments.last().is_some_and(|segment| segment.groups.end == groups.len()) {
            open = groups.len();
        }
        // The latest covers all earlier ones of its lane.
        let end = ends.into_iter().map(|end| number[end]).max().filter(|&end| waited.is_none_or(|waited| end > waited));
        waited = waited.max(end);
        waits.extend(end);
        let main_passes: Vec<usize> =
            levels.get(at).into_iter().flatten().copied().filter(|p| !on_side.contains(p)).collect();
        if !main_passes.is_empty() {
            groups.push(Group { barrier: None, passes: main_passes });
        }
    }
    segments.push(Segment { lane: Lane::Main, groups: open..groups.len(), waits, last: None });
    (groups, segments)
}

/// Returns, by group, the first and last group index that may run concurrently with it.
pub(super) fn spans(groups: usize, segments: &[Segment]) -> Vec<(usize, usize)> {
    let mut spans: Vec<(usize, usize)> = (0..groups).map(|at| (at, at)).collect();
    for (number, segment) in segments.iter().enumerate().filter(|(_, segment)| segment.lane == Lane::Side) {
        // A wait for this segment or a later one of its lane covers it.
        let waits = |later: &&Segment| later.lane == Lane::Main && later.waits.iter().any(|&wait| wait >= number);
        let end = segments[number..].iter().find(waits).map_or(groups, |later| later.groups.start);
        for at in segment.groups.clone() {
            spans[at] = (segment.groups.start, end.saturating_sub(1).max(at));
        }
    }
    spans
}
