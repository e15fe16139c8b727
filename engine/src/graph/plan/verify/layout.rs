//! Layout verification: every image is in a layout that its users allow, from entry to exit state, and keeps needed
//! contents.

use super::{VerifyError, buffer_name, pass_name};
use crate::graph::pass::Use;
use crate::graph::plan::{ImageMemory, Plan, Transition};
use crate::graph::resource::{BufferKind, ImageState};
use crate::shader::Access;

/// Checks the layouts of all images.
pub(super) fn check(plan: &Plan) -> Result<(), VerifyError> {
    // By buffer, then by slot: current state, and whether the contents may be discarded now.
    let mut states: Vec<Option<(ImageState, bool)>> = plan.buffers.iter().map(|_| None).collect();
    for (index, info) in plan.buffers.iter().enumerate() {
        let Some(image) = &info.image else { continue };
        if info.kind == BufferKind::External {
            states[index] = Some((image.entry, image.entry == ImageState::Undefined));
        } else if let Some(slot) = plan.placements[index] {
            let image_slot = usize::try_from(slot).ok().and_then(|slot| plan.image_slots.get(slot));
            if !image_slot.is_some_and(|image_slot| image_slot.size == image.size && image_slot.format == image.format)
            {
                return Err(VerifyError::WrongSlot { image: info.name.clone(), slot });
            }
        }
    }
    let slots = plan.image_slots.iter().map(|_| Some((ImageState::Undefined, true)));
    states.extend(slots);

    change(plan, "beginning", &plan.entry, &mut states)?;
    for &pass in plan.groups.iter().flat_map(|group| &group.passes) {
        for (slice, access, used) in &plan.passes[pass].accesses {
            let index = slice.buffer.index();
            let info = &plan.buffers[index];
            if info.image.is_none() {
                continue;
            }
            let at = match (info.kind, plan.placements[index]) {
                (BufferKind::External, _) => index,
                (_, Some(slot)) => plan.buffers.len() + slot as usize,
                // The memory check reports this.
                (_, None) => continue,
            };
            let state = states[at].map_or(ImageState::Undefined, |(state, _)| state);
            let allowed = match (used, access) {
                (Use::Transfer, Access::Read) => {
                    matches!(state, ImageState::General | ImageState::TransferSource)
                }
                (Use::Transfer, _) => matches!(state, ImageState::General | ImageState::TransferTarget),
                (Use::Compute, _) => state == ImageState::General,
                (Use::Indirect | Use::Uniform, _) => false,
            };
            let image = || buffer_name(plan, index);
            if !allowed {
                return Err(VerifyError::Layout { pass: pass_name(plan, pass), image: image(), state });
            }
            if plan.homes[index] != Some(state) {
                let home = plan.homes[index].unwrap_or(ImageState::Undefined);
                return Err(VerifyError::Home { image: image(), home, is: state });
            }
        }
    }
    // From here on, contents must be preserved.
    states.iter_mut().flatten().for_each(|(_, discardable)| *discardable = false);
    change(plan, "end", &plan.exit, &mut states)?;
    for (index, info) in plan.buffers.iter().enumerate().filter(|(_, info)| info.kind == BufferKind::External) {
        if let (Some(image), Some((is, _))) = (&info.image, states[index])
            && is != image.exit
        {
            return Err(VerifyError::Left { image: info.name.clone(), is, exit: image.exit });
        }
    }
    Ok(())
}

/// Applies transitions to the states.
fn change(
    plan: &Plan,
    at: &'static str,
    transitions: &[Transition],
    states: &mut [Option<(ImageState, bool)>],
) -> Result<(), VerifyError> {
    let mut changed = vec![false; states.len()];
    for Transition { image, from, to } in transitions {
        let (index, name) = match image {
            ImageMemory::External(image) => {
                let name = plan.buffers.get(image.index()).map_or("?", |info| info.name.as_str());
                (image.index(), format!("image [{name}]"))
            }
            ImageMemory::Slot(slot) => (plan.buffers.len() + *slot as usize, format!("image slot {slot}")),
        };
        let wrong = |what| Err(VerifyError::Transition { at, image: name.clone(), what });
        let Some(Some((state, discardable))) = states.get_mut(index) else { return wrong("does not exist") };
        if std::mem::replace(&mut changed[index], true) {
            return wrong("changes twice there");
        }
        if *to == ImageState::Undefined {
            return wrong("nothing can become undefined");
        }
        if from != state && !(*discardable && *from == ImageState::Undefined) {
            return Err(VerifyError::TransitionFrom { at, image: name, from: *from, is: *state });
        }
        (*state, *discardable) = (*to, false);
    }
    // A plan without groups has no barrier for transitions.
    if plan.groups.is_empty() && !transitions.is_empty() {
        return Err(VerifyError::Transition { at, image: "an image".into(), what: "has no barrier" });
    }
    Ok(())
}
