//! Simulations against cases that are computed by hand.

use super::*;

fn job(seconds: f64, ends: &[End]) -> Job {
    Job { seconds, cost: (1e3 * seconds) as u128, ends: ends.to_vec() }
}

fn done(seconds: f64) -> Job {
    job(seconds, &[End::Done])
}

fn run(devices: usize, jobs: &[Job], change: &dyn Fn(&mut Plan)) -> Outcome {
    let mut plan = Plan::ideal(jobs.iter().map(|j| j.seconds).collect(), devices);
    change(&mut plan);
    simulate_jobs(&plan, jobs)
}

fn near(a: f64, b: f64) {
    assert!((a - b).abs() < 1e-6, "{a} is not {b}");
}

#[test]
fn one_device_needs_the_sum() {
    let out = run(1, &[done(3.0), done(5.5), done(2.0)], &|_| {});
    near(out.makespan, 10.5);
    near(out.bound(1), 10.5);
    assert_eq!((out.done, out.failed, out.wasted), (3, 0, 0.0));
}

#[test]
fn equal_runs_need_whole_rounds() {
    let jobs = vec![done(7.0); 10];
    for (devices, rounds) in [(1, 10.0), (3, 4.0), (5, 2.0), (10, 1.0), (16, 1.0)] {
        near(run(devices, &jobs, &|_| {}).makespan, 7.0 * rounds);
    }
}

#[test]
fn most_expensive_runs_start_first() {
    // In the order of the manifest two devices would need 1 + 1 + 10 seconds.
    near(run(2, &[done(1.0), done(1.0), done(1.0), done(10.0)], &|_| {}).makespan, 10.0);
    // A wrong estimate starts the longest last.
    let wrong = [done(1.0), done(1.0), Job { cost: 0, ..done(10.0) }];
    near(run(2, &wrong, &|_| {}).makespan, 11.0);
}

#[test]
fn lost_worker_costs_the_expiry_and_the_rest() {
    // Worker 0 dies at half of the bound of 100 s. Its lease was renewed at 50 s. The other worker trains until 100 s,
    // then sees the lease for the first time, and again each 0.5 s until 115 s. The last checkpoint is that of 40 s.
    let jobs = [done(100.0), done(100.0)];
    let lose = |plan: &mut Plan| {
        plan.lose = 0.5;
        plan.checkpoint = 40.0;
        plan.resume = 3.0;
    };
    let out = run(2, &jobs, &lose);
    near(out.makespan, 100.0 + 15.0 + 3.0 + 60.0);
    near(out.takeover.unwrap(), 65.0);
    near(out.wasted, 10.0 + 3.0);
    assert_eq!((out.deaths, out.taken_over, out.done), (1, 1, 2));
    // An idle third worker sees the last renewal at 50 s. It takes the run over 15 s later.
    let out = run(3, &jobs, &|plan| {
        lose(plan);
        plan.lose = 1.0 / 3.0;
    });
    near(out.makespan, 50.0 + 15.0 + 3.0 + 60.0);
}

#[test]
fn failed_attempts_are_retried_from_checkpoints() {
    // Half of 100 s is lost but for the checkpoint of 40 s; the delay is 1 s, loading takes 3 s.
    let retried = job(100.0, &[End::Temporary(0.5), End::Done]);
    let out = run(1, &[retried], &|plan| (plan.checkpoint, plan.resume) = (40.0, 3.0));
    near(out.makespan, 50.0 + 1.0 + 3.0 + 60.0);
    near(out.wasted, 10.0 + 1.0 + 3.0);
    // Two retries wait 1 and 2 s; then the run fails.
    let failing = job(100.0, &[End::Temporary(0.5), End::Temporary(0.5), End::Temporary(0.5)]);
    let out = run(1, &[failing, done(5.0)], &|_| {});
    near(out.makespan, 50.0 + 1.0 + 50.0 + 2.0 + 50.0 + 5.0);
    assert_eq!((out.done, out.failed, out.temporary), (1, 1, 3));
    // A wrong scene fails at once.
    let out = run(1, &[job(100.0, &[End::Permanent(0.1)])], &|_| {});
    near(out.makespan, 10.0);
    assert_eq!((out.failed, out.wasted), (1, 0.0));
}

#[test]
fn renewals_and_claims_are_counted() {
    // One worker, one run of 20 s: 10 renewals, each reads its lease, asks for the next one, writes and renames.
    let leases = |protocol| run(1, &[done(20.0)], &|plan| plan.protocol = protocol).load.ops.leases;
    // Start: two folders, one listing. First: claim 2 + 4, 10 renewals of 7, end 4 + 2 + 1.
    near(leases(Protocol::First), 4.0 + 6.0 + 10.0 * 7.0 + 7.0);
    // A pass is one listing, and a renewal asks for one file in place of the listing.
    near(leases(Protocol::Current), 4.0 + 2.0 + 6.0 + 10.0 * 6.0 + 6.0);
}

#[test]
fn equal_seeds_give_equal_simulations() {
    let plan = |seed| {
        let mut plan = Plan::ideal(vec![20.0, 30.0, 45.0], 32);
        (plan.rooms, plan.seed, plan.disk.latency, plan.estimate_error) = (500, seed, 1e-3, 0.3);
        plan.rates = super::super::plan::Rates { temporary: 0.05, permanent: 0.02, worker: 5.0, repair: 60.0 };
        plan
    };
    let figures = |seed| format!("{:?}", simulate(&plan(seed)));
    assert_eq!(figures(1), figures(1));
    assert_ne!(figures(1), figures(2));
    let out = simulate(&plan(1));
    assert_eq!(out.done + out.failed, 500);
    assert!(out.temporary > 5 && out.failed > 2 && out.deaths > 1, "{out:?}");
    assert!(out.makespan >= out.bound(32), "{out:?}");
}

#[test]
fn drawn_times_keep_their_mean() {
    for distribution in [super::super::plan::Distribution::Empirical, super::super::plan::Distribution::Lognormal] {
        let mut plan = Plan::ideal(vec![20.0, 30.0, 45.0, 90.0], 1);
        (plan.rooms, plan.distribution, plan.mean) = (20_000, distribution, Some(600.0));
        let mean = plan.jobs().iter().map(|j| j.seconds).sum::<f64>() / 20_000.0;
        assert!((mean / 600.0 - 1.0).abs() < 0.02, "{distribution:?}: {mean}");
    }
}
