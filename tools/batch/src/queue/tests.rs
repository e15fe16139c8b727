//! Queues over processes that only pretend: retries, limits, stops and lost leases.

use super::*;
use crate::batch::tests::{batch, run};
use crate::process::{Launch, Phase, Process};
use std::sync::Arc;
use std::sync::atomic::AtomicUsize;
use std::time::Instant;

/// Returns what a process does. The number counts the run's earlier processes.
type Script<'a> = dyn Fn(&Launch<'_>, usize) -> Act + Sync + 'a;

/// What a pretended process does.
#[derive(Clone)]
enum Act {
    /// Ends with a status, a kind and a sentence.
    End(Option<i32>, &'static str),
    /// Runs until it is terminated, then ends with a status.
    Wait(i32),
    /// Runs until it is killed.
    Hang,
    /// Runs for a while, then ends with a status and a kind.
    After(Duration, i32, &'static str),
    /// Ends with an answer.
    Answer(String),
}

struct Pretended {
    act: Act,
    begun: Instant,
    ended: Option<Option<i32>>,
    beats: Arc<AtomicUsize>,
    kills: Arc<AtomicUsize>,
    running: Arc<Mutex<(usize, usize)>>,
}

impl Drop for Pretended {
    fn drop(&mut self) {
        lock(&self.running).0 -= 1;
    }
}

impl Process for Pretended {
    fn poll(&mut self) -> std::io::Result<Option<Exit>> {
        let (status, kind) = match (&self.act, self.ended) {
            (Act::End(status, kind), _) => (*status, *kind),
            (Act::After(time, status, kind), _) if self.begun.elapsed() >= *time => (Some(*status), *kind),
            (Act::Answer(output), _) => {
                return Ok(Some(Exit { status: Some(0), signal: None, output: output.clone() }));
            }
            (_, Some(status)) => (status, "terminated"),
            (_, None) => return Ok(None),
        };
        let output = format!("{{\"kind\": \"{kind}\", \"error\": \"it was {kind}\"}}");
        let output = if status.is_none() { String::new() } else { output };
        Ok(Some(Exit { status, signal: status.is_none().then_some(9), output }))
    }

    fn terminate(&mut self) {
        if let Act::Wait(status) = self.act {
            self.ended = Some(Some(status));
        }
    }

    fn kill(&mut self) {
        self.kills.fetch_add(1, Ordering::SeqCst);
        self.ended = Some(None);
    }

    fn beat(&mut self) {
        self.beats.fetch_add(1, Ordering::SeqCst);
    }
}

/// Started process: name of the run, phase, whether it resumes, memory budget.
type Start = (String, Phase, bool, Option<u64>);

/// Starts pretended processes and records them.
struct Pretender<'a> {
    script: &'a Script<'a>,
    starts: Mutex<Vec<Start>>,
    beats: Arc<AtomicUsize>,
    kills: Arc<AtomicUsize>,
    /// Memory of the one device, if it is known.
    memory: Option<u64>,
    /// Forecasts: operations of a step and bytes of a run.
    plan: &'a (dyn Fn(&Run) -> Option<(f64, u64)> + Sync),
    /// Number of processes that train, and the largest such number.
    running: Arc<Mutex<(usize, usize)>>,
}

impl<'a> Pretender<'a> {
    fn new(script: &'a Script<'a>) -> Self {
        Pretender {
            script,
            starts: Mutex::default(),
            beats: Arc::default(),
            kills: Arc::default(),
            memory: None,
            plan: &|_| None,
            running: Arc::default(),
        }
    }

    fn starts(&self) -> Vec<Start> {
        lock(&self.starts).clone()
    }

    fn most_at_once(&self) -> usize {
        lock(&self.running).1
    }
}

impl Launcher for Pretender<'_> {
    fn device(&self, _worker: usize) -> Option<DeviceMemory> {
        self.memory.map(|bytes| DeviceMemory { uuid: "one".into(), bytes })
    }

    fn start(&self, launch: &Launch<'_>) -> std::io::Result<Box<dyn Process>> {
        let pretended = |act| {
            let mut running = lock(&self.running);
            running.0 += 1;
            if launch.phase != Phase::Plan {
                running.1 = running.1.max(running.0);
            }
            let (beats, kills, running) = (self.beats.clone(), self.kills.clone(), self.running.clone());
            Box::new(Pretended { act, begun: Instant::now(), ended: None, beats, kills, running })
        };
        if launch.phase == Phase::Plan {
            return Ok(pretended(match (self.plan)(launch.run) {
                Some((operations, bytes)) => Act::Answer(format!(
                    "{{\"expected\": [{{\"bytes\": {bytes}, \"step_operations\": {operations}}}]}}"
                )),
                None => Act::End(Some(42), "input"),
            }));
        }
        let name = launch.run.name();
        let mut starts = lock(&self.starts);
        let earlier = starts.iter().filter(|s| s.0 == name).count();
        starts.push((name, launch.phase, launch.resume, launch.memory_budget));
        drop(starts);
        std::fs::create_dir_all(&launch.directory)?;
        std::fs::write(launch.directory.join("config.toml"), "")?;
        Ok(pretended((self.script)(launch, earlier)))
    }
}

const QUICK: Timing = Timing {
    heartbeat: Duration::from_millis(20),
    give_up: Duration::from_millis(500),
    poll: Duration::from_millis(2),
    idle: Duration::from_millis(5),
    delay: Duration::from_millis(1),
    longest_delay: Duration::from_millis(4),
    grace: Duration::from_millis(50),
};

struct Setup {
    folder: tempfile::TempDir,
    batch: Batch,
    stop: AtomicBool,
    retry_failed: bool,
    jobs: usize,
}

impl Setup {
    fn new(seeds: u64) -> Setup {
        let batch = batch((0..seeds).map(|seed| run("a", seed)).collect());
        let folder = tempfile::tempdir().unwrap();
        Setup { folder, batch, stop: AtomicBool::new(false), retry_failed: false, jobs: 1 }
    }

    fn work(&self, launcher: &dyn Launcher) -> Report {
        let store = Store::open(self.folder.path(), Duration::from_secs(60)).unwrap();
        let queue = Queue {
            store: &store,
            batch: &self.batch,
            launcher,
            stop: &self.stop,
            progress: &|_| {},
            jobs: self.jobs,
            retry_failed: self.retry_failed,
            retry_temporary: false,
            summarize: true,
            shard: None,
            timing: QUICK,
        };
        queue.work().unwrap()
    }

    fn result(&self, i: usize) -> Option<RunResult> {
        Store::open(self.folder.path(), Duration::from_secs(60)).unwrap().result(&self.batch.runs[i])
    }

    fn leases(&self) -> usize {
        std::fs::read_dir(self.folder.path().join("leases")).unwrap().count()
    }
}

#[test]
fn failed_run_is_recorded_and_others_are_done() {
    let mut setup = Setup::new(3);
    setup.batch.evaluate = true;
    let launcher = Pretender::new(&|l, _| match l.run.seed {
        1 => Act::End(Some(42), "input"),
        _ => Act::End(Some(0), ""),
    });
    let report = setup.work(&launcher);
    assert_eq!((report.runs, report.done, report.skipped, report.failed.len()), (3, 2, 0, 1));
    let failed = setup.result(1).unwrap();
    assert_eq!((failed.status, failed.kind.as_deref(), failed.attempts), (Some(42), Some("input"), 1));
    assert_eq!(failed.error.as_deref(), Some("it was input"));
    let done = setup.result(2).unwrap();
    assert!(done.evaluated && done.state == State::Done);
    assert_eq!(launcher.starts().len(), 5, "one failed, two were trained and evaluated");
    assert_eq!(setup.leases(), 0);
    // Nothing is started again, unless failed runs are requested.
    let report = setup.work(&launcher);
    assert_eq!((report.done, report.skipped, report.failed.len(), launcher.starts().len()), (0, 2, 1, 5));
    setup.retry_failed = true;
    let report = setup.work(&Pretender::new(&|_, _| Act::End(Some(0), "")));
    assert_eq!((report.done, report.skipped, report.failed.len()), (1, 2, 0));
    assert_eq!(setup.result(1).unwrap().attempts, 2);
}

#[test]
fn temporary_failures_are_retried_with_less_memory() {
    let mut setup = Setup::new(1);
    setup.batch.limits.memory_budget = Some(1000);
    let launcher = Pretender::new(&|_, earlier| match earlier {
        0 => Act::End(Some(75), "out_of_memory"),
        1 => Act::End(None, "killed"),
        _ => Act::End(Some(0), ""),
    });
    assert_eq!(setup.work(&launcher).done, 1);
    let starts: Vec<_> = launcher.starts().into_iter().map(|(_, _, resume, bytes)| (resume, bytes)).collect();
    assert_eq!(starts, [(false, Some(1000)), (true, Some(750)), (true, Some(750))]);
    let result = setup.result(0).unwrap();
    assert_eq!((result.attempts, result.memory_budget), (3, Some(750)));

    let setup = Setup::new(1);
    let launcher = Pretender::new(&|_, _| Act::End(None, "killed"));
    assert_eq!(setup.work(&launcher).failed.len(), 1);
    assert_eq!(launcher.starts().len(), 3, "the limit is two retries");
    let result = setup.result(0).unwrap();
    assert_eq!((result.kind.as_deref(), result.status), (Some("killed"), None));
    assert!(result.error.unwrap().contains("signal 9"));
}

#[test]
fn locked_directories_are_awaited() {
    let setup = Setup::new(1);
    let launcher = Pretender::new(&|_, earlier| match earlier {
        0..5 => Act::End(Some(1), "locked"),
        _ => Act::End(Some(0), ""),
    });
    assert_eq!(setup.work(&launcher).done, 1);
    assert_eq!((launcher.starts().len(), setup.result(0).unwrap().attempts), (6, 1));
}

#[test]
fn attempts_are_limited_in_time() {
    for act in [Act::Wait(75), Act::Hang] {
        let mut setup = Setup::new(1);
        setup.batch.limits.timeout = Some(Duration::from_millis(30));
        let script = move |_: &Launch<'_>, _: usize| act.clone();
        let launcher = Pretender::new(&script);
        assert_eq!(setup.work(&launcher).failed.len(), 1);
        assert_eq!(setup.result(0).unwrap().kind.as_deref(), Some("timeout"));
        assert_eq!(launcher.starts().len(), 1);
    }
}

#[test]
fn stopped_queue_releases_its_runs() {
    let mut setup = Setup::new(3);
    setup.jobs = 2;
    let launcher = Pretender::new(&|_, _| Act::Wait(75));
    let report = std::thread::scope(|scope| {
        scope.spawn(|| {
            while launcher.starts().len() < 2 || launcher.beats.load(Ordering::SeqCst) < 4 {
                std::thread::sleep(Duration::from_millis(1));
            }
            setup.stop.store(true, Ordering::SeqCst);
        });
        setup.work(&launcher)
    });
    assert!(report.stopped && report.failed.is_empty() && setup.result(0).is_none());
    setup.stop.store(false, Ordering::SeqCst);
    // The released runs are resumed at once.
    let launcher = Pretender::new(&|_, _| Act::End(Some(0), ""));
    let report = setup.work(&launcher);
    assert_eq!((report.done, report.stopped), (3, false));
    assert_eq!(launcher.starts().iter().filter(|s| s.2).count(), 2);
}

#[test]
fn lost_lease_ends_the_process_without_a_result() {
    let setup = Setup::new(1);
    let run = setup.batch.runs[0].clone();
    let leases = setup.folder.path().join("leases");
    let script = |_: &Launch<'_>, _: usize| {
        // Another worker takes the run over and is done before the queue looks again.
        Lease::create(&leases, &run.key(), 2).unwrap().unwrap();
        Act::Hang
    };
    let launcher = Pretender::new(&script);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            let store = Store::open(setup.folder.path(), Duration::from_secs(60)).unwrap();
            while launcher.starts().is_empty() {
                std::thread::sleep(Duration::from_millis(1));
            }
            std::thread::sleep(Duration::from_millis(200));
            let (kills, found) = (launcher.kills.load(Ordering::SeqCst), (store.result(&run), setup.leases()));
            // The stop ends a queue that waits for the other worker.
            setup.stop.store(true, Ordering::SeqCst);
            assert_eq!((kills, found), (1, (None, 2)));
        });
        let report = setup.work(&launcher);
        assert!(report.stopped && report.failed.is_empty());
    });
    assert_eq!((launcher.starts().len(), setup.result(0)), (1, None));
}

#[test]
fn changed_run_begins_in_an_empty_directory() {
    let mut setup = Setup::new(1);
    let launcher = Pretender::new(&|_, _| Act::End(Some(0), ""));
    setup.work(&launcher);
    let directory = setup.batch.runs[0].path(setup.folder.path(), "");
    std::fs::create_dir(directory.join("checkpoint")).unwrap();
    setup.batch.runs[0].identity = "changed".into();
    setup.work(&launcher);
    assert!(!directory.join("checkpoint").exists());
    assert!(launcher.starts().iter().all(|s| !s.2), "a changed run was resumed");
    assert_eq!(setup.result(0).unwrap().identity, "changed");
}

#[test]
fn queues_over_one_directory_train_each_run_once() {
    let mut setup = Setup::new(24);
    setup.jobs = 3;
    let launcher = Pretender::new(&|_, _| Act::End(Some(0), ""));
    let reports: Vec<Report> = std::thread::scope(|scope| {
        let queues: Vec<_> = (0..3).map(|_| scope.spawn(|| setup.work(&launcher))).collect();
        queues.into_iter().map(|q| q.join().unwrap()).collect()
    });
    assert!(reports.iter().all(|r| r.done + r.skipped == 24 && r.failed.is_empty() && !r.stopped), "{reports:?}");
    let mut names: Vec<_> = launcher.starts().into_iter().map(|s| s.0).collect();
    names.sort();
    names.dedup();
    assert_eq!((launcher.starts().len(), names.len(), setup.leases()), (24, 24, 0));
    let lines = std::fs::read_to_string(setup.folder.path().join("summary.jsonl")).unwrap();
    assert_eq!(lines.lines().count(), 24);
}

/// Returns a batch of runs in scenes of these names.
fn scenes(names: &[&str]) -> Batch {
    let costs = (0..).zip(names).map(|(i, name)| Run { cost: [1, 3, 2, 0][i], ..run(name, 0) });
    batch(costs.collect())
}

const WHILE: Duration = Duration::from_millis(30);

#[test]
fn expensive_runs_start_first_and_share_the_device_while_they_fit() {
    let mut setup = Setup::new(0);
    setup.batch = scenes(&["small", "large", "middle", "broken"]);
    let script = |_: &Launch<'_>, _: usize| Act::After(WHILE, 0, "");
    let plan = |run: &Run| match run.scene.as_str() {
        "small" => Some((1.0, 300)),
        "middle" => Some((2.0, 500)),
        "large" => Some((3.0, 500)),
        _ => None,
    };
    for (memory, jobs, most) in [(1000, 4, 2), (2000, 4, 3), (2000, 2, 2), (400, 4, 1), (1000, 1, 1)] {
        setup.folder = tempfile::tempdir().unwrap();
        setup.jobs = jobs;
        let launcher = Pretender { memory: Some(memory), plan: &plan, ..Pretender::new(&script) };
        assert_eq!(setup.work(&launcher).done, 4);
        assert_eq!(launcher.most_at_once(), most, "{memory} bytes, {jobs} jobs");
        if jobs == 1 {
            // By the estimate: nothing is planned for a single job.
            let names: Vec<_> = launcher.starts().into_iter().map(|s| s.0).collect();
            assert_eq!(names, ["large", "middle", "small", "broken"].map(|scene| format!("{scene}/fast/seed0")));
        }
    }
    // Without knowledge of the device, each job has a run.
    setup.folder = tempfile::tempdir().unwrap();
    setup.jobs = 4;
    let launcher = Pretender { plan: &plan, ..Pretender::new(&script) };
    assert_eq!((setup.work(&launcher).done, launcher.most_at_once()), (4, 4));
}

#[test]
fn forecasts_are_made_once_for_all_seeds() {
    let mut setup = Setup::new(3);
    setup.jobs = 2;
    let plans = AtomicUsize::new(0);
    let plan = |_: &Run| {
        plans.fetch_add(1, Ordering::SeqCst);
        Some((1.0, 300))
    };
    let script = |_: &Launch<'_>, _: usize| Act::End(Some(0), "");
    let launcher = Pretender { memory: Some(1000), plan: &plan, ..Pretender::new(&script) };
    assert_eq!((setup.work(&launcher).done, plans.load(Ordering::SeqCst)), (3, 1));
    for run in &mut setup.batch.runs {
        run.identity.push('2');
    }
    assert_eq!((setup.work(&launcher).done, plans.load(Ordering::SeqCst)), (3, 1));
    for run in &mut setup.batch.runs {
        run.identity.push('3');
        run.plan_identity.push('3');
    }
    assert_eq!((setup.work(&launcher).done, plans.load(Ordering::SeqCst)), (3, 2));
}

#[test]
fn run_out_of_memory_is_repeated_alone_and_then_with_less() {
    let mut setup = Setup::new(4);
    setup.jobs = 4;
    let launcher_at = Mutex::new(None::<Arc<Mutex<(usize, usize)>>>);
    let beside = Mutex::new(Vec::new());
    // The first run exhausts the memory three times.
    let script = |launch: &Launch<'_>, earlier: usize| {
        if launch.run.seed != 0 {
            return Act::After(4 * WHILE, 0, "");
        }
        let running = lock(&launcher_at).clone().unwrap();
        lock(&beside).push(lock(&running).0);
        match earlier {
            0..2 => Act::After(WHILE, 75, "out_of_memory"),
            _ => Act::After(WHILE, 0, ""),
        }
    };
    let plan = |_: &Run| Some((1.0, 100));
    let launcher = Pretender { memory: Some(1000), plan: &plan, ..Pretender::new(&script) };
    *lock(&launcher_at) = Some(launcher.running.clone());
    assert_eq!(setup.work(&launcher).done, 4);
    let mine: Vec<_> = launcher.starts().into_iter().filter(|s| s.0.ends_with("seed0")).map(|s| s.3).collect();
    assert_eq!(mine, [None, None, Some(750)], "alone with all memory, then alone with less");
    assert_eq!(lock(&beside)[1..], [0, 0], "another run was on the device");
    assert_eq!(launcher.most_at_once(), 4);
}

#[test]
fn full_disk_stops_the_queue_and_fails_no_run() {
    let mut setup = Setup::new(3);
    setup.jobs = 2;
    let launcher = Pretender::new(&|launch, _| match launch.run.seed {
        0 => Act::End(Some(1), "storage"),
        _ => Act::Wait(75),
    });
    let report = setup.work(&launcher);
    assert_eq!(report.storage.as_deref(), Some("it was storage"));
    assert!(report.stopped && report.failed.is_empty() && report.done == 0);
    assert!((0..3).all(|i| setup.result(i).is_none()) && launcher.starts().len() <= 2);
    let report = setup.work(&Pretender::new(&|_, _| Act::End(Some(0), "")));
    assert_eq!((report.done, report.stopped, report.storage), (3, false, None));
}

#[test]
fn many_dead_leases_are_all_taken_over() {
    let setup = Setup::new(Timing::LOOKS as u64 + 40);
    let expiry = Duration::from_millis(150);
    let other = Store::open(setup.folder.path(), expiry).unwrap();
    // Another worker holds all runs and never renews its leases.
    for run in &setup.batch.runs {
        assert!(matches!(other.claim(run, false, None).unwrap(), Claim::Held(_)));
    }
    let begun = Instant::now();
    let script = |_: &Launch<'_>, _: usize| {
        assert!(begun.elapsed() >= expiry, "taken over after {:?}", begun.elapsed());
        Act::End(Some(0), "")
    };
    let launcher = Pretender::new(&script);
    let store = Store::open(setup.folder.path(), expiry).unwrap();
    let queue = Queue {
        store: &store,
        batch: &setup.batch,
        launcher: &launcher,
        stop: &setup.stop,
        progress: &|_| {},
        jobs: 2,
        retry_failed: false,
        retry_temporary: false,
        summarize: true,
        shard: None,
        timing: QUICK,
    };
    let report = queue.work().unwrap();
    assert_eq!((report.done, setup.leases()), (Timing::LOOKS + 40, 0));
    let mut names: Vec<_> = launcher.starts().into_iter().map(|s| s.0).collect();
    names.sort();
    names.dedup();
    assert_eq!((names.len(), launcher.starts().len()), (Timing::LOOKS + 40, Timing::LOOKS + 40));
}

#[test]
fn summaries_are_written_at_intervals_and_at_the_end() {
    // The interval of 400 runs is 4 s, longer than the test.
    let mut setup = Setup::new(400);
    setup.jobs = 4;
    let path = setup.folder.path().join("summary.jsonl");
    let lines = || std::fs::read_to_string(&path).unwrap_or_default().lines().count();
    let seen = Mutex::new(std::collections::BTreeSet::new());
    let script = |_: &Launch<'_>, _: usize| {
        lock(&seen).insert(lines());
        Act::End(Some(0), "")
    };
    let begun = Instant::now();
    let report = setup.work(&Pretender::new(&script));
    assert_eq!((report.done, lines()), (400, 400));
    let written = lock(&seen).iter().filter(|n| **n > 0).count() as u64;
    assert!((1..=1 + 2 * (1 + begun.elapsed().as_secs() / 4) + 4).contains(&written), "{seen:?}");
}
