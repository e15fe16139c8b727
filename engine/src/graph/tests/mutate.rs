//! Mutation tests of the verifier: each change breaks a valid plan and must be detected.
//!
//! Because every removed barrier bit is detected, no barrier bit is redundant.

use proptest::prelude::*;

use super::random::recipes;
use super::*;

/// Returns every weakened plan with a description of what is missing. A weakened plan lacks a barrier, one of its
/// bits, or a stage with its accesses.
fn weakened_plans(plan: &Plan) -> Vec<(String, Plan)> {
    let mut found = Vec::new();
    for at in 0..=plan.groups.len() {
        let barrier = plan.groups.get(at).map_or(plan.final_barrier, |group| group.barrier);
        let Some(barrier) = barrier else { continue };
        let mut less = |what: String, barrier: Option<Barrier>| {
            let mut plan = plan.clone();
            *plan.groups.get_mut(at).map_or(&mut plan.final_barrier, |group| &mut group.barrier) = barrier;
            found.push((format!("{what} before group {at}"), plan));
        };
        less("barrier".into(), None);
        let Barrier { src_stage, src_access, dst_stage, dst_access } = barrier;
        for access in Accesses::ALL {
            if src_access.contains(access) {
                less(format!("source {access}"), Some(Barrier { src_access: src_access.without(access), ..barrier }));
            }
            if dst_access.contains(access) {
                less(format!("target {access}"), Some(Barrier { dst_access: dst_access.without(access), ..barrier }));
            }
        }
        for stage in Stages::ALL {
            let others = |set: Accesses| {
                Accesses::ALL
                    .into_iter()
                    .filter(|access| access.stages() == stage)
                    .fold(set, |set, access| set.without(access))
            };
            if src_stage.contains(stage) {
                let src_stage = src_stage.without(stage);
                less(format!("source {stage}"), Some(Barrier { src_stage, ..barrier }));
                let barrier = Barrier { src_stage, src_access: others(src_access), ..barrier };
                less(format!("source {stage} and its accesses"), Some(barrier));
            }
            if dst_stage.contains(stage) {
                let dst_stage = dst_stage.without(stage);
                less(format!("target {stage}"), Some(Barrier { dst_stage, ..barrier }));
                let barrier = Barrier { dst_stage, dst_access: others(dst_access), ..barrier };
                less(format!("target {stage} and its accesses"), Some(barrier));
            }
        }
    }
    found
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn verifier_detects_missing_barrier_bits(recipe in recipes(30)) {
        let plan = recipe.build().compile(&recipe.options).unwrap();
        for (what, weak) in weakened_plans(&plan) {
            prop_assert!(verify(&weak).is_err(), "{} is not detected in\n{}", what, plan);
        }
    }

    #[test]
    fn verifier_detects_damaged_transitions(recipe in recipes(25)) {
        let plan = recipe.build().compile(&recipe.options).unwrap();
        let lists: [fn(&mut Plan) -> &mut Vec<Transition>; 2] = [|plan| &mut plan.entry, |plan| &mut plan.exit];
        for list in lists {
            let mut copy = plan.clone();
            for at in 0..list(&mut copy).len() {
                let damage = |what: &str, change: &dyn Fn(&mut Vec<Transition>)| {
                    let mut copy = plan.clone();
                    change(list(&mut copy));
                    prop_assert!(verify(&copy).is_err(), "{} {} is not detected in\n{}", what, at, plan);
                    Ok(())
                };
                damage("change", &|list| _ = list.remove(at))?;
                damage("a second change like", &|list| list.push(list[at]))?;
                damage("target of", &|list| list[at].to = ImageState::ColorAttachment)?;
                let undefined = list(&mut copy)[at].from == ImageState::Undefined;
                if !undefined {
                    damage("contents before", &|list| list[at].from = ImageState::Undefined)?;
                }
            }
        }
    }

    #[test]
    fn verifier_detects_dropped_passes(recipe in recipes(30)) {
        let plan = recipe.build().compile(&recipe.options).unwrap();
        let places = plan.groups.iter().enumerate().flat_map(|(at, group)| group.passes.iter().map(move |&p| (at, p)));
        for (group, pass) in places {
            let mut less = plan.clone();
            less.groups[group].passes.retain(|&other| other != pass);
            let lost = matches!(verify(&less), Err(VerifyError::NotOnce { times: 0, .. }));
            prop_assert!(lost);
            less.culled.push(pass);
            let verify_error_after = matches!(verify(&less), Err(VerifyError::NeededPassCulled { .. }));
            prop_assert!(verify_error_after, "{} is not detected in\n{}", plan.passes[pass].name, plan);
        }
    }

    #[test]
    fn verifier_detects_passes_before_dependencies(recipe in recipes(30)) {
        let plan = recipe.build().compile(&recipe.options).unwrap();
        let mut group_of = vec![0; plan.passes.len()];
        for (at, group) in plan.groups.iter().enumerate() {
            group.passes.iter().for_each(|&pass| group_of[pass] = at);
        }
        for (pass, follows) in plan.dependencies().into_iter().enumerate() {
            for before in follows {
                let mut moved = plan.clone();
                moved.groups[group_of[pass]].passes.retain(|&other| other != pass);
                moved.groups[group_of[before as usize]].passes.push(pass);
                let verify_error_after = matches!(verify(&moved), Err(VerifyError::Order { .. }));
                prop_assert!(verify_error_after, "{} before {} in\n{}", plan.passes[pass].name, before, plan);
            }
        }
    }

    #[test]
    fn verifier_detects_swapped_groups(recipe in recipes(30)) {
        let plan = recipe.build().compile(&recipe.options).unwrap();
        let follows = plan.dependencies();
        for at in 1..plan.groups.len() {
            let depends = |&pass: &usize| {
                plan.groups[at - 1].passes.iter().any(|&before| follows[pass].contains(&(before as u32)))
            };
            if plan.groups[at].passes.iter().any(depends) {
                let mut swapped = plan.clone();
                swapped.groups.swap(at - 1, at);
                prop_assert!(verify(&swapped).is_err(), "groups {} and {} in\n{}", at - 1, at, plan);
            }
        }
    }

    #[test]
    fn verifier_detects_overlapping_transients(recipe in recipes(30)) {
        let plan = recipe.build().compile(&recipe.options).unwrap();
        let lifetimes = plan.lifetimes();
        let living = || {
            let buffers = lifetimes.iter().enumerate().filter(|(index, _)| plan.buffers[*index].image.is_none());
            buffers.filter_map(|(index, life)| life.map(|life| (index, life)))
        };
        for (first, (start, end)) in living() {
            for (second, _) in living().filter(|&(other, (s, e))| other != first && s <= end && start <= e) {
                let mut plan = plan.clone();
                plan.placements[first] = plan.placements[second];
                plan.arena_bytes += plan.buffers[first].bytes;
                let verify_error_after = matches!(verify(&plan), Err(VerifyError::Overlap { .. }));
                prop_assert!(verify_error_after, "{} on {} in\n{}", first, second, plan);
            }
            let mut plan = plan.clone();
            plan.placements[first] = Some(plan.arena_bytes);
            let outside = matches!(verify(&plan), Err(VerifyError::OutOfArena { .. }));
            prop_assert!(outside);
            plan.placements[first] = None;
            let unplaced = matches!(verify(&plan), Err(VerifyError::Unplaced { .. }));
            prop_assert!(unplaced);
        }
    }

    #[test]
    fn verifier_detects_overlapping_images(recipe in recipes(30)) {
        let plan = recipe.build().compile(&recipe.options).unwrap();
        let lifetimes = plan.lifetimes();
        let living = || {
            let images = lifetimes.iter().enumerate().filter(|(index, _)| plan.buffers[*index].image.is_some());
            images.filter_map(|(index, life)| life.map(|life| (index, life)))
        };
        for (first, (start, end)) in living() {
            for (second, _) in living().filter(|&(other, (s, e))| other != first && s <= end && start <= e) {
                let mut plan = plan.clone();
                plan.placements[first] = plan.placements[second];
                let verify_error_after = matches!(
                    verify(&plan),
                    Err(VerifyError::Overlap { .. }
                        | VerifyError::WrongSlot { .. }
                        | VerifyError::Layout { .. }
                        | VerifyError::Home { .. })
                );
                prop_assert!(verify_error_after, "{} with {} in\n{}", first, second, plan);
            }
            let mut plan = plan.clone();
            plan.placements[first] = Some(plan.image_slots.len() as u64);
            let nowhere = matches!(verify(&plan), Err(VerifyError::WrongSlot { .. }));
            prop_assert!(nowhere);
            plan.placements[first] = None;
            let unplaced = matches!(verify(&plan), Err(VerifyError::Unplaced { .. }));
            prop_assert!(unplaced);
        }
    }

    #[test]
    fn verifier_detects_undeclared_accesses(recipe in recipes(15)) {
        let plan = recipe.build().compile(&recipe.options).unwrap();
        for (pass, at) in (0..plan.passes.len()).flat_map(|p| (0..plan.passes[p].accesses.len()).map(move |a| (p, a))) {
            let mut less = plan.clone();
            less.passes[pass].accesses.remove(at);
            let verify_error_after = matches!(verify(&less), Err(VerifyError::Undeclared { .. }));
            prop_assert!(verify_error_after);
            let mut other = plan.clone();
            let used = &mut other.passes[pass].accesses[at].2;
            *used = if *used == Use::Transfer { Use::Compute } else { Use::Transfer };
            let verify_error_after = matches!(verify(&other), Err(VerifyError::Undeclared { .. }));
            prop_assert!(verify_error_after);
        }
    }
}
