use super::*;

/// Watch of `views` views whose plain colors are off by 0.2.
fn watch(views: usize) -> Watch {
    Watch::new(vec![0.2; views])
}

/// Feeds steps with these losses and differences until divergence. Returns the step and the description.
fn run(w: &mut Watch, steps: std::ops::RangeInclusive<u32>, of: impl Fn(u32) -> (f32, f32)) -> Option<(u32, String)> {
    let views = w.sums.len() as u32;
    steps.into_iter().find_map(|step| {
        let (loss, l1) = of(step);
        let seen = Seen { step, view: (step % views) as usize, loss, l1, skipped: 0, of: 10, rates: 1.0 };
        w.see(&seen).map(|wrong| (step, wrong))
    })
}

#[test]
fn divergence_from_the_second_step_is_detected() {
    for views in [1, 6, 21, 300] {
        let mut w = watch(views);
        let block = w.block;
        let (step, wrong) = run(&mut w, 1..=4000, |s| if s == 1 { (0.24, 0.17) } else { (0.3, 0.21) }).unwrap();
        assert!(step > GRACE && step <= GRACE + 2 * block && w.good_until == 0, "{step} of {views} views");
        assert!(wrong.contains("1.25 times") && wrong.contains("0.210") && wrong.contains("0.200"), "{wrong}");
    }
}

#[test]
fn convergence_and_stagnation_are_not_divergence() {
    let never = |of: fn(u32) -> (f32, f32)| {
        let mut w = watch(7);
        assert_eq!(run(&mut w, 1..=5000, of), None);
        w
    };
    // Convergence; a bad start that does not change; good splats that get much worse, but not bad.
    assert!(never(|s| (0.3 / s as f32, 0.2 / s as f32)).good_until > 4000);
    assert!(never(|_| (0.9, 0.8)).good_until > 4000);
    assert!(never(|s| if s < 2 { (0.01, 0.01) } else { (0.16, 0.15) }).good_until > 4000);
    // Losses differ between views: the first view is the easiest.
    never(|s| if s % 7 == 1 { (0.1, 0.3) } else { (0.9, 0.7) });
}

#[test]
fn candidate_is_validated_after_a_good_block() {
    let mut w = watch(6);
    let good = |_| (0.1, 0.1);
    assert_eq!(run(&mut w, 1..=150, good), None);
    assert!(w.set_candidate(150) && !w.validate_candidate());
    assert_eq!(run(&mut w, 151..=200, good), None);
    assert!(!w.set_candidate(200) && w.is_candidate(150) && !w.validate_candidate());
    assert_eq!(run(&mut w, 201..=240, good), None);
    assert!(w.validate_candidate() && !w.validate_candidate() && w.set_candidate(240));
    let (step, _) = run(&mut w, 241..=900, |_| (0.5, 0.5)).unwrap();
    assert!(step == 300 && !w.validate_candidate());
}

#[test]
fn rough_rates_suffice_for_divergence_and_validate_nothing() {
    let of = |rates: f64, l1: f32| {
        let mut w = watch(6);
        let found = (1..=1000)
            .find_map(|step| w.see(&Seen { step, view: (step % 6) as usize, loss: 0.3, l1, skipped: 0, of: 0, rates }));
        (found, w.good_until)
    };
    let (found, trusted) = of(100.0, 0.19);
    assert!(found.unwrap().ends_with("learning rates are up to 100 times their defaults") && trusted == 0);
    assert_eq!(of(100.0, 0.1), (None, 0));
    assert_eq!(of(10.0, 0.19), (None, 960));
}

#[test]
fn reset_restarts_evaluation() {
    let mut w = watch(7);
    let good = |_| (0.03, 0.02);
    let bad = |_| (0.5, 0.4);
    assert_eq!(run(&mut w, 1..=200, good), None);
    w.restart(200);
    // Images are dark for long, but no worse than just after the reset.
    assert_eq!(run(&mut w, 201..=900, bad), None);
    assert_eq!(run(&mut w, 901..=1200, good), None);
    let (step, wrong) = run(&mut w, 1201..=2000, bad).unwrap();
    assert!(step < 1400 && wrong.contains("all views"), "{step}: {wrong}");
}

#[test]
fn most_gradients_not_finite_is_divergence() {
    let of = |share: u32| {
        let mut w = watch(5);
        (1..=400).find_map(|step| {
            let seen = Seen {
                step,
                view: (step % 5) as usize,
                loss: 0.1,
                l1: 0.1,
                skipped: step * share,
                of: 100,
                rates: 1.0,
            };
            w.see(&seen)
        })
    };
    assert_eq!(of(50), None);
    assert!(of(51).unwrap().contains("of 6000 gradients were not finite"));
}

#[test]
fn restored_watch_continues_identically() {
    let of = |s: u32| if s == 1 { (0.24, 0.17) } else { (0.2 + 0.001 * s as f32, 0.15 + 0.0007 * s as f32) };
    let straight = run(&mut watch(7), 1..=500, of).unwrap();
    for at in [1, 77, 160] {
        let mut first = watch(7);
        assert_eq!(run(&mut first, 1..=at, of), None);
        let mut second = watch(7);
        assert!(second.restore(&first.save()));
        assert_eq!(second, first);
        assert_eq!(run(&mut second, at + 1..=500, of).unwrap(), straight);
    }
    let mut w = watch(7);
    for text in ["", "nonsense", "1 2 3", &watch(6).save()] {
        assert!(!w.restore(text));
        assert_eq!(w, watch(7));
    }
}

#[test]
fn views_held_out_are_not_evaluated() {
    // One view of six is never rendered. The others are good, then bad.
    let run = |w: &mut Watch, steps: std::ops::RangeInclusive<u32>, loss: f32, l1: f32, unseen: usize| {
        steps.into_iter().find_map(|step| {
            let view = step as usize % (6 - unseen);
            let seen = Seen { step, view, loss, l1, skipped: 0, of: 10, rates: 1.0 };
            w.see(&seen).map(|wrong| (step, wrong))
        })
    };
    let mut w = watch(6);
    assert_eq!(run(&mut w, 1..=240, 0.1, 0.1, 0), None);
    assert_eq!(run(&mut w, 241..=480, 0.05, 0.05, 1), None);
    assert_eq!(w.good_until, 480);
    assert!(w.reference[4].unwrap() < 0.06 && w.reference[5].unwrap() > 0.09);
    let (step, wrong) = run(&mut w, 481..=900, 0.3, 0.21, 1).unwrap();
    assert!(step == 540 && wrong.contains("of all views is 6.00 times"), "{step}: {wrong}");
    // Nothing is evaluated where most views are held out.
    let mut w = watch(6);
    assert_eq!(run(&mut w, 1..=60, 0.1, 0.1, 0), None);
    assert_eq!(run(&mut w, 61..=900, 0.9, 0.9, 4), None);
}

#[test]
fn extreme_state_does_not_overflow() {
    let mut w = watch(2);
    let most = "ffffffffffffffff";
    let text = [most; 13].join(" ");
    assert!(w.restore(&text));
    for step in [1, 2, 59, 60, u32::MAX - 1, u32::MAX] {
        w.see(&Seen { step, view: 0, loss: 0.1, l1: 0.1, skipped: 1, of: 1, rates: 1.0 });
        w.validate_candidate();
    }
}
