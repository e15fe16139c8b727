//! Discrete events of a queue: workers that claim, train, fail, take over and wait.

use super::disk::{Costs, Ops, Protocol};
use super::outcome::Outcome;
use super::plan::{End, Job, Plan};
use sgs_batch::Timing;
use sgs_passes::rng::Pcg;
use std::cmp::Reverse;
use std::collections::{BTreeSet, BinaryHeap, HashMap};

/// Nanoseconds since all workers are ready.
type Time = u64;

const SECOND: f64 = 1e9;

fn nanoseconds(seconds: f64) -> Time {
    (seconds * SECOND).round() as Time
}

fn seconds(time: Time) -> f64 {
    time as f64 / SECOND
}

/// What happens to a worker. The order breaks ties of equal times.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Event {
    /// The machine of a worker fails. The flag: whether it is started again.
    Die(bool),
    /// The worker is started.
    Start,
    /// It looks for a run.
    Pass,
    /// It claims the run at a place of the order after a number of lost claims.
    Claim(usize, u32),
    /// It claims a run at a place of the order whose holder is dead.
    TakeOver(usize),
    /// It starts an attempt of the run that it holds.
    Attempt,
    /// The attempt ends.
    End,
    /// The run has its result.
    Finished,
    /// It has read and written the summary while this number of runs had ended. The flag: as its last action.
    Summary(usize, bool),
}

/// Planned event: time, number, worker, number of its starts, and what happens.
type Planned = (Time, u64, usize, u32, Event);

#[derive(Clone, Copy, Debug, PartialEq)]
enum State {
    Fresh,
    Held,
    /// Its holder is silent since this time.
    Dead(Time),
    Ended,
}

/// Run in the queue.
struct Run {
    state: State,
    /// When it was claimed last.
    claimed: Time,
    /// Seconds of work in the last checkpoint.
    saved: f64,
    /// Attempts that have ended by themselves.
    attempts: usize,
    /// When its holder died, until it is claimed again.
    lost: Option<Time>,
}

/// Run that a worker holds.
struct Hold {
    run: usize,
    since: Time,
    /// Retries of this worker.
    retries: u32,
    /// When the current attempt began to work.
    working: Option<Time>,
    /// Whether the attempt resumes.
    resumes: bool,
    /// Whether the run failed for good.
    failed: bool,
}

struct Worker {
    alive: bool,
    /// Number of its starts. Events of an earlier one are void.
    epoch: u32,
    hold: Option<Hold>,
    /// Number of results that it has read.
    known: usize,
    /// Position of its window over leases of others.
    cursor: usize,
    /// When it first saw a dead lease, by run.
    seen: HashMap<usize, Time>,
    exited: bool,
}

/// State of a simulation.
struct Simulation<'a> {
    plan: &'a Plan,
    jobs: &'a [Job],
    order: Vec<usize>,
    costs: Costs,
    now: Time,
    events: BinaryHeap<Reverse<Planned>>,
    sequence: u64,
    runs: Vec<Run>,
    workers: Vec<Worker>,
    /// Places of runs that never had a lease.
    fresh: BTreeSet<usize>,
    /// Places of runs with a lease.
    leased: BTreeSet<usize>,
    place: Vec<usize>,
    /// Runs whose holder is dead.
    dead: BTreeSet<usize>,
    ended: usize,
    last_summary: Option<Time>,
    /// When the large loss happened.
    loss: Option<Time>,
    victims: BTreeSet<usize>,
    random: Pcg,
    out: Outcome,
}

/// Simulates a queue.
pub fn simulate(plan: &Plan) -> Outcome {
    simulate_jobs(plan, &plan.jobs())
}

/// Simulates a queue over given runs.
pub fn simulate_jobs(plan: &Plan, jobs: &[Job]) -> Outcome {
    let order = Plan::order(jobs);
    let mut place = vec![0; jobs.len()];
    order.iter().enumerate().for_each(|(at, run)| place[*run] = at);
    let mut random = Pcg::new(plan.seed ^ 0x5eed_0001);
    let worker =
        |cursor| Worker { alive: true, epoch: 0, hold: None, known: 0, cursor, seen: HashMap::new(), exited: false };
    let workers = (0..plan.devices).map(|_| worker((random.uniform() * plan.devices as f64) as usize)).collect();
    let new = |_| Run { state: State::Fresh, claimed: 0, saved: 0.0, attempts: 0, lost: None };
    let mut simulation = Simulation {
        plan,
        jobs,
        order,
        costs: Costs(plan.protocol),
        now: 0,
        events: BinaryHeap::new(),
        sequence: 0,
        runs: (0..jobs.len()).map(new).collect(),
        workers,
        fresh: (0..jobs.len()).collect(),
        leased: BTreeSet::new(),
        place,
        dead: BTreeSet::new(),
        ended: 0,
        last_summary: None,
        loss: None,
        victims: BTreeSet::new(),
        random,
        out: Outcome::default(),
    };
    simulation.out.work = jobs.iter().map(Job::necessary).sum();
    simulation.out.longest = jobs.iter().map(Job::necessary).fold(0.0, f64::max);
    simulation.work();
    simulation.out
}

impl Simulation<'_> {
    fn work(&mut self) {
        for worker in 0..self.workers.len() {
            self.push(worker, 0.0, Event::Start);
        }
        let lost = (self.plan.lose * self.plan.devices as f64).round() as usize;
        let half = 0.5 * self.out.bound(self.plan.devices);
        (0..lost).for_each(|worker| self.push(worker, half, Event::Die(false)));
        while let Some(Reverse((time, _, worker, epoch, event))) = self.events.pop() {
            let valid = self.workers[worker].epoch == epoch && !self.workers[worker].exited;
            if !valid || !self.workers[worker].alive && event != Event::Start {
                continue;
            }
            self.now = time;
            self.happen(worker, event);
        }
        if self.loss.is_some() && self.victims.is_empty() {
            // The lost workers may have held no runs.
            self.out.takeover = self.out.takeover.or(Some(0.0));
        }
    }

    fn push(&mut self, worker: usize, delay: f64, event: Event) {
        self.sequence += 1;
        let epoch = self.workers[worker].epoch;
        self.events.push(Reverse((self.now + nanoseconds(delay), self.sequence, worker, epoch, event)));
    }

    /// Plans the next failure of a worker.
    fn push_failure(&mut self, worker: usize) {
        if self.plan.rates.worker > 0.0 {
            let delay = -self.random.uniform().ln() * 3600.0 / self.plan.rates.worker;
            self.push(worker, delay, Event::Die(true));
        }
    }

    /// Counts operations. Returns the seconds that one worker needs for them.
    fn spend(&mut self, ops: Ops) -> f64 {
        self.out.load.add(seconds(self.now), &ops);
        ops.total() * self.plan.disk.latency
    }

    fn happen(&mut self, worker: usize, event: Event) {
        match event {
            Event::Die(again) => self.die(worker, again),
            Event::Start => {
                self.workers[worker].alive = true;
                self.push_failure(worker);
                let ops = self.costs.start(self.jobs.len(), self.leased.len(), self.ended);
                self.workers[worker].known = self.ended;
                let delay = self.spend(ops);
                self.push(worker, delay, Event::Pass);
            }
            Event::Pass => self.pass(worker),
            Event::Claim(at, losses) => self.claim(worker, at, Some(losses)),
            Event::TakeOver(at) => self.claim(worker, at, None),
            Event::Attempt => self.attempt(worker),
            Event::End => self.end(worker),
            Event::Finished => self.finished(worker),
            Event::Summary(then, last) => self.summarized(worker, then, last),
        }
    }

    fn pass(&mut self, worker: usize) {
        if self.ended == self.jobs.len() {
            self.summarize(worker, true);
            return;
        }
        let held = self.leased.len();
        let mut ops = self.costs.pass(held);
        let unread = self.ended - std::mem::replace(&mut self.workers[worker].known, self.ended);
        ops += self.costs.result() * unread as f64;
        let looks = if self.plan.protocol == Protocol::Current { held.min(Timing::LOOKS) } else { held };
        ops += self.costs.look(held) * looks as f64;
        let free = self.look(worker, looks);
        let delay = self.spend(ops);
        match free {
            Some(at) => {
                self.out.blocked += delay;
                self.push(worker, delay, Event::TakeOver(at));
            }
            None => {
                if let Some(at) = self.fresh.first().copied() {
                    self.out.blocked += delay;
                    self.push(worker, delay, Event::Claim(at, 0));
                    return;
                }
                let idle = match self.plan.protocol {
                    Protocol::First => self.plan.timing.idle,
                    Protocol::Current => self.plan.timing.idle_delay(held),
                };
                self.push(worker, delay + idle.as_secs_f64(), Event::Pass);
            }
        }
    }

    /// Looks at leases of others. Returns the place of the first run whose lease has expired for this worker.
    fn look(&mut self, worker: usize, looks: usize) -> Option<usize> {
        let held = self.leased.len();
        let start = self.workers[worker].cursor % held.max(1);
        self.workers[worker].cursor = start + looks;
        if self.dead.is_empty() {
            return None;
        }
        let mut found = None;
        for &run in &self.dead {
            let at = self.place[run];
            let rank = self.leased.range(..at).count();
            // The window wraps around.
            if (rank + held - start) % held >= looks {
                continue;
            }
            let State::Dead(silent) = self.runs[run].state else { continue };
            let first = *self.workers[worker].seen.entry(run).or_insert(self.now);
            // A renewal after the first look starts the time again.
            let since = if first < silent { self.now } else { first };
            self.workers[worker].seen.insert(run, since);
            if seconds(self.now - since) >= self.plan.expiry && found.is_none_or(|best| at < best) {
                found = Some(at);
            }
        }
        found
    }

    /// Claims a run. `losses`: lost claims of this pass; `None` if the run has a dead holder.
    fn claim(&mut self, worker: usize, at: usize, losses: Option<u32>) {
        let Some(&run) = self.order.get(at) else {
            self.push(worker, 0.0, Event::Pass);
            return;
        };
        let held = self.leased.len();
        let dead = losses.is_none();
        let free = match self.runs[run].state {
            State::Fresh => !dead,
            State::Dead(_) => dead,
            State::Held | State::Ended => false,
        };
        if !free {
            let raced = self.now.saturating_sub(self.runs[run].claimed) <= nanoseconds(6.0 * self.plan.disk.latency);
            let ops = if raced || dead { self.costs.lost_race(held) } else { self.costs.look(held) };
            self.out.lost_races += usize::from(raced);
            let delay = self.spend(ops);
            self.out.blocked += delay;
            let Some(losses) = losses.map(|l| l + 1) else {
                self.push(worker, delay, Event::Pass);
                return;
            };
            // The first version goes on with the next run. This one lists the leases again and skips some free runs.
            let next = match self.plan.protocol {
                Protocol::First => at + 1,
                Protocol::Current => {
                    let skips = (self.random.uniform() * Timing::spread(losses) as f64) as usize;
                    self.fresh.range(at..).nth(skips).copied().unwrap_or(self.order.len())
                }
            };
            self.push(worker, delay, Event::Claim(next, losses));
            return;
        }
        let ops = self.costs.claim(held, dead) + self.costs.attempt();
        let delay = self.spend(ops);
        self.runs[run].state = State::Held;
        self.runs[run].claimed = self.now;
        self.leased.insert(at);
        if dead {
            self.dead.remove(&run);
            self.out.taken_over += 1;
            for other in &mut self.workers {
                other.seen.remove(&run);
            }
            self.victims.remove(&run);
            if let (Some(loss), true) = (self.loss, self.victims.is_empty() && self.runs[run].lost.is_some()) {
                self.out.takeover = self.out.takeover.or(Some(seconds(self.now - loss)));
            }
            self.runs[run].lost = None;
        } else {
            self.fresh.remove(&at);
        }
        let resumes = dead;
        self.workers[worker].hold =
            Some(Hold { run, since: self.now, retries: 0, working: None, resumes, failed: false });
        self.out.blocked += delay;
        self.push(worker, delay, Event::Attempt);
    }

    fn attempt(&mut self, worker: usize) {
        let (plan, jobs) = (self.plan, self.jobs);
        let Some(hold) = self.workers[worker].hold.as_mut() else { return };
        let load = if hold.resumes { plan.resume } else { 0.0 };
        hold.working = Some(self.now + nanoseconds(load));
        let run = &self.runs[hold.run];
        let job = &jobs[hold.run];
        let rest = (job.seconds - run.saved).max(0.0);
        let work = match job.ends.get(run.attempts) {
            Some(End::Temporary(share)) => share * rest,
            Some(End::Permanent(share)) => (share * job.seconds - run.saved).max(0.0),
            Some(End::Done) | None => rest,
        };
        self.out.wasted += load;
        self.push(worker, load + work, Event::End);
    }

    /// Returns the work of a run that its last checkpoint holds.
    fn checkpoint(&self, work: f64) -> f64 {
        if self.plan.checkpoint.is_finite() {
            (work / self.plan.checkpoint).floor() * self.plan.checkpoint
        } else {
            0.0
        }
    }

    /// Adds the work of an interrupted attempt to the run's checkpoint. The rest is lost.
    fn interrupt(&mut self, run: usize, working: Option<Time>) {
        let worked = working.map_or(0.0, |since| seconds(self.now.saturating_sub(since)));
        let reached = self.runs[run].saved + worked;
        let saved = self.checkpoint(reached).max(self.runs[run].saved);
        self.out.wasted += reached - saved;
        self.runs[run].saved = saved;
    }

    fn end(&mut self, worker: usize) {
        let jobs = self.jobs;
        let Some((run, working)) = self.workers[worker].hold.as_ref().map(|h| (h.run, h.working)) else { return };
        let end = jobs[run].ends.get(self.runs[run].attempts).copied().unwrap_or(End::Done);
        let mut failed = matches!(end, End::Permanent(_));
        if matches!(end, End::Temporary(_)) {
            self.out.temporary += 1;
            let retries = self.workers[worker].hold.as_ref().map_or(0, |h| h.retries);
            if retries < self.plan.retries {
                self.interrupt(run, working);
                self.runs[run].attempts += 1;
                let delay = self.plan.timing.retry_delay(retries + 1).as_secs_f64();
                let ops = self.costs.attempt();
                let begin = self.spend(ops);
                self.out.wasted += delay;
                if let Some(hold) = self.workers[worker].hold.as_mut() {
                    (hold.retries, hold.working, hold.resumes) = (retries + 1, None, true);
                }
                self.push(worker, delay + begin, Event::Attempt);
                return;
            }
            failed = true;
            self.out.wasted += working.map_or(0.0, |since| seconds(self.now - since)) + self.runs[run].saved;
        }
        if let Some(hold) = self.workers[worker].hold.as_mut() {
            hold.failed = failed;
        }
        let ops = self.costs.finish(self.leased.len());
        let delay = self.spend(ops);
        self.out.blocked += delay;
        self.push(worker, delay, Event::Finished);
    }

    /// Ends the hold of a worker and counts its renewals and checkpoints.
    fn let_go(&mut self, worker: usize) -> Option<Hold> {
        let hold = self.workers[worker].hold.take()?;
        let beat = self.plan.timing.heartbeat.as_secs_f64();
        let (from, to) = (seconds(hold.since), seconds(self.now));
        let renewals = ((to - from) / beat).floor();
        self.out.load.spread(from, to, &(self.costs.renewal(self.leased.len()) * renewals));
        let checkpoints = ((to - from) / self.plan.checkpoint).floor();
        self.out.load.spread_bytes(from, to, checkpoints * self.plan.sizes.checkpoint);
        Some(hold)
    }

    fn finished(&mut self, worker: usize) {
        let Some(hold) = self.let_go(worker) else { return };
        let sizes = self.plan.sizes;
        self.out.load.add_bytes(seconds(self.now), sizes.run + sizes.checkpoint + sizes.result);
        self.runs[hold.run].state = State::Ended;
        self.leased.remove(&self.place[hold.run]);
        self.ended += 1;
        if hold.failed {
            self.out.failed += 1
        } else {
            self.out.done += 1
        }
        self.workers[worker].known += 1;
        self.out.makespan = self.out.makespan.max(seconds(self.now));
        let ops = self.costs.age();
        let delay = self.spend(ops);
        let fresh = self.plan.protocol == Protocol::Current
            && self.last_summary.is_some_and(|last| {
                seconds(self.now - last) < self.plan.timing.summary_interval(self.jobs.len()).as_secs_f64()
            });
        if fresh {
            self.push(worker, delay, Event::Pass);
        } else {
            self.summarize(worker, false);
        }
    }

    /// Starts an update of the summary.
    fn summarize(&mut self, worker: usize, last: bool) {
        let (rooms, ended) = (self.jobs.len(), self.ended);
        let unread = ended - self.workers[worker].known;
        if self.plan.protocol == Protocol::Current {
            self.workers[worker].known = ended;
        }
        let differs = !(last && self.last_summary.is_some_and(|t| t >= nanoseconds(self.out.makespan)));
        let first = self.costs.results(rooms, ended, unread);
        let again = match self.plan.protocol {
            Protocol::Current if !last => Ops::NONE,
            _ => self.costs.results(rooms, ended, 0),
        };
        let ops = first + self.costs.files(differs) + again;
        // Three files hold each result; the tables are about as long as the lines.
        let text = 3.0 * self.plan.sizes.result * ended as f64;
        let passes = 1.0 + if again == Ops::NONE { 0.0 } else { 1.0 };
        let read = if self.plan.protocol == Protocol::First { passes * ended as f64 } else { unread as f64 };
        let bytes = text + if differs { text } else { 0.0 } + read * self.plan.sizes.result;
        self.out.load.add_bytes(seconds(self.now), bytes);
        self.out.summaries += usize::from(differs);
        self.last_summary = Some(self.now);
        let duration = self.spend(ops) + bytes / self.plan.disk.bytes;
        self.out.blocked += duration;
        self.out.longest_summary = self.out.longest_summary.max(duration);
        self.push(worker, duration, Event::Summary(ended, last));
    }

    fn summarized(&mut self, worker: usize, then: usize, last: bool) {
        // The first version repeats it until nothing changed meanwhile.
        if self.plan.protocol == Protocol::First && then != self.ended {
            self.summarize(worker, last);
        } else if last {
            self.workers[worker].exited = true;
            self.out.end = self.out.end.max(seconds(self.now));
        } else {
            self.push(worker, 0.0, Event::Pass);
        }
    }

    fn die(&mut self, worker: usize, again: bool) {
        self.out.deaths += 1;
        if !again {
            self.loss = Some(self.now);
        }
        if let Some(hold) = self.let_go(worker) {
            let beat = self.plan.timing.heartbeat.as_secs_f64();
            let beats = (seconds(self.now - hold.since) / beat).floor();
            self.interrupt(hold.run, hold.working);
            self.runs[hold.run].state = State::Dead(hold.since + nanoseconds(beats * beat));
            self.runs[hold.run].lost = Some(self.now);
            self.dead.insert(hold.run);
            if !again {
                self.victims.insert(hold.run);
            }
        }
        let own = &mut self.workers[worker];
        own.alive = false;
        own.epoch += 1;
        own.seen.clear();
        if again {
            self.push(worker, self.plan.rates.repair, Event::Start);
        }
    }
}

#[cfg(test)]
#[path = "tests.rs"]
mod tests;
