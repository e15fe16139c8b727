//! Images without a device: layouts, slot aliasing, external users, declaration errors, damaged plans.

use super::kernels::{kernel, pass, with_kinds};
use super::*;
use crate::format::ImageFormat;
use crate::shader::Access::{Read, ReadWrite, Write};
use crate::shader::BindingKind;

const SIZE: [u32; 2] = [4, 4];
const FLOAT: ImageFormat = ImageFormat::Rgba32Float;

fn compile(graph: Graph) -> Plan {
    graph.compile(&CompileOptions::default()).unwrap()
}

fn whole(image: Image) -> Slice {
    image.0.slice(0, 256)
}

/// Graph that writes a window's image by copies only.
fn window() -> Graph {
    let mut graph = Graph::new("window");
    let texels = graph.input("texels", 64);
    let image =
        graph.external_image("image", SIZE, ImageFormat::Bgra8Unorm, ImageState::Undefined, ImageState::Present);
    graph.copy_to_image("show", texels, image).unwrap();
    graph
}

#[test]
fn copy_only_image_uses_transfer_layout() {
    let plan = compile(window());
    let image = ImageMemory::External(Image(Buffer(1)));
    assert_eq!(
        plan.entry,
        [Transition { image, from: ImageState::Undefined, to: ImageState::TransferTarget }],
        "contents from the host are discarded"
    );
    assert_eq!(plan.exit, [Transition { image, from: ImageState::TransferTarget, to: ImageState::Present }]);
    // Host commands before, the copy, host commands after.
    let entry = plan.groups[0].barrier.unwrap();
    assert_eq!(entry.to_string(), "outside[outside_write] -> transfer[transfer_write]");
    let exit = plan.final_barrier.unwrap();
    assert_eq!(exit.to_string(), "transfer[transfer_write] -> outside[outside_read|outside_write]");
}

#[test]
fn kernels_use_the_general_layout() {
    let mut graph = Graph::new("general");
    let image = graph.external_image("image", SIZE, FLOAT, ImageState::ShaderRead, ImageState::ShaderRead);
    let out = graph.external("out", 256);
    pass(&mut graph, "change", &[(whole(image), ReadWrite)]);
    graph.copy_from_image("read", image, out).unwrap();
    let plan = compile(graph);
    assert_eq!(plan.homes[0], Some(ImageState::General));
    assert_eq!((plan.entry.len(), plan.exit.len()), (1, 1));
    // Between the passes, a global barrier suffices.
    assert_eq!(plan.groups[1].barrier.unwrap().to_string(), "compute[storage_write] -> transfer[transfer_read]");
}

#[test]
fn unused_external_image_is_transitioned() {
    let mut graph = Graph::new("through");
    graph.external_image("image", SIZE, FLOAT, ImageState::General, ImageState::Present);
    let plan = compile(graph);
    assert_eq!((plan.groups.len(), plan.entry.len(), plan.exit.len()), (1, 1, 0));
    assert_eq!(
        plan.groups[0].barrier.unwrap().to_string(),
        "outside[outside_write] -> outside[outside_read|outside_write]"
    );
}

/// Graph with a chain of three transients, of which two can alias.
fn chain() -> Graph {
    let mut graph = Graph::new("chain");
    let out = graph.external("out", 256);
    let [a, b, c] = ["a", "b", "c"].map(|name| graph.transient_image(name, SIZE, FLOAT));
    graph.clear_image("clear", a, [0.0; 4]).unwrap();
    pass(&mut graph, "ab", &[(whole(a), Read), (whole(b), Write)]);
    pass(&mut graph, "bc", &[(whole(b), Read), (whole(c), Write)]);
    pass(&mut graph, "end", &[(whole(c), Read), (out.slice(0, 256), Write)]);
    graph
}

#[test]
fn transient_images_alias() {
    let plan = compile(chain());
    assert_eq!(plan.placements, [None, Some(0), Some(1), Some(0)]);
    assert_eq!(plan.image_slots.len(), 2);
    assert_eq!(plan.arena_bytes, 0);
    let apart = chain().compile(&CompileOptions { alias: false, ..Default::default() }).unwrap();
    assert_eq!(apart.image_slots.len(), 3);
    // Only memory aliasing orders the reader of `a` before the writer of `c`.
    let mut damaged = plan.clone();
    damaged.groups[2].barrier = None;
    assert!(matches!(verify(&damaged), Err(VerifyError::Hazard { .. })));
}

#[test]
fn buffers_can_be_shared_with_the_queue() {
    let build = |entry, exit| {
        let mut graph = Graph::new("seam");
        let buffer = graph.external("buffer", 256);
        graph.shared(buffer, entry, exit);
        pass(&mut graph, "change", &[(buffer.slice(0, 256), ReadWrite)]);
        compile(graph)
    };
    let queue = build(BufferState::Queue, BufferState::Queue);
    let text = |barrier: Option<Barrier>| barrier.unwrap().to_string();
    assert_eq!(text(queue.groups[0].barrier), "outside[outside_write] -> compute[storage_read|storage_write]");
    assert_eq!(text(queue.final_barrier), "compute[storage_write] -> outside[outside_read|outside_write]");
    let ready = build(BufferState::Ready, BufferState::Ready);
    let host = build(BufferState::Host, BufferState::Host);
    assert_eq!(ready.groups, host.groups, "submission makes host writes visible");
    assert_ne!(ready.key, host.key);
    // Each side alone.
    assert_eq!(text(build(BufferState::Queue, BufferState::Ready).final_barrier), text(ready.final_barrier));
    let mut damaged = queue.clone();
    damaged.final_barrier = None;
    assert_eq!(
        verify(&damaged).unwrap_err().to_string(),
        "Pass [change] accesses [buffer], which other commands use after the replay, but no barrier makes the write \
         visible to outside_read|outside_write."
    );
}

#[test]
fn dumps_show_layouts() {
    let plan = compile(window());
    let text = dump::text(&plan);
    let expected = "image external image 4x4 bgra8unorm, undefined on entry, present on exit";
    assert!(text.contains(expected), "{text}");
    assert!(text.contains("layout of image: undefined -> transfer target"), "{text}");
    assert!(dump::dot(&plan).contains("layout of image: undefined -> transfer target"));
    let json: serde_json::Value = serde_json::from_str(&dump::json(&plan)).unwrap();
    assert_eq!(json["buffers"][1]["image"]["home"], "transfer_target");
    assert_eq!(json["exit"][0]["to"], "present");
    assert_eq!(json["exit"][0]["image"]["external"], 1);
    let text = dump::text(&compile(chain()));
    assert!(text.contains("a transient image 4x4 rgba32float in slot 0, groups 0..=1"), "{text}");
}

#[test]
fn declarations_of_images_are_checked() {
    let mut graph = Graph::new("g");
    graph.transient_image("flat", [4, 0], FLOAT);
    let error = graph.clone().compile(&CompileOptions::default()).unwrap_err();
    assert_eq!(error.to_string(), "Image [flat] is declared with 4 x 0 texels, but a side has 1 to 65536.");
    let mut graph = Graph::new("g");
    graph.external_image("lost", SIZE, FLOAT, ImageState::General, ImageState::Undefined);
    let error = graph.compile(&CompileOptions::default()).unwrap_err();
    assert_eq!(
        error.to_string(),
        "Image [lost] has exit state Undefined; an external image needs a defined exit state."
    );
    let mut graph = Graph::new("g");
    let scratch = graph.transient("scratch", 16);
    graph.shared(scratch, BufferState::Queue, BufferState::Ready);
    let error = graph.compile(&CompileOptions::default()).unwrap_err();
    assert_eq!(error.to_string(), "Buffer [scratch] cannot be shared with the queue: it is not an external buffer.");
}

#[test]
fn uses_of_images_are_checked() {
    let mut graph = Graph::new("g");
    let buffer = graph.external("buffer", 512);
    let uniform = graph.uniform("uniform", 256);
    let image = graph.external_image("image", SIZE, FLOAT, ImageState::Undefined, ImageState::General);
    let input = graph.input_image("input", SIZE, FLOAT, ImageState::General);
    let other = graph.transient_image("other", SIZE, ImageFormat::R32Float);
    let message = |result: Result<(), GraphError>| result.unwrap_err().to_string();
    assert_eq!(message(graph.fill("f", image.0, 0)), "Pass [f] uses image [image] as a buffer.");
    assert_eq!(message(graph.clear_image("c", Image(buffer), [0.0; 4])), "Pass [c] uses buffer [buffer] as an image.");
    assert_eq!(
        message(graph.clear_image("c", Image(Buffer(9)), [0.0; 4])),
        "Pass [c] uses buffer number 9, but its graph has 5 buffers."
    );
    assert_eq!(
        message(graph.copy_to_image("c", buffer, image)),
        "Pass [c] copies 512 bytes of buffer [buffer] to or from image [image] of 256 bytes."
    );
    assert_eq!(
        message(graph.copy_to_image("c", buffer.slice(4, 256), image)),
        "Pass [c] copies texels of 16 bytes to or from buffer [buffer] at offset 4, not a multiple of that."
    );
    assert_eq!(
        message(graph.copy_to_image("c", uniform, image)),
        "Pass [c] uses uniform [uniform] as the source of a copy, but only kernels can read it."
    );
    assert_eq!(
        message(graph.clear_image("c", input, [0.0; 4])),
        "Pass [c] writes buffer [input] through [clear], but it is a read-only input."
    );
    assert_eq!(
        message(graph.copy_from_image("c", image, buffer.slice(0, 256))),
        "Pass [c] reads 256 bytes at offset 0 of transient buffer [image], which no earlier pass writes."
    );
    let float = with_kinds("k", &[(BindingKind::Image(FLOAT), Write)]);
    assert_eq!(
        message(graph.pass("p", &float).bind("b0", buffer).dispatch([1, 1, 1])),
        "Pass [p] binds [buffer] as [b0], which the kernel declares as an image."
    );
    assert_eq!(
        message(graph.pass("p", &float).bind_image("b0", other).dispatch([1, 1, 1])),
        "Pass [p] binds image [other] of format r32float as [b0], which the kernel declares rgba32float."
    );
    let storage = kernel("s", &[Read]);
    assert_eq!(
        message(graph.pass("p", &storage).bind_image("b0", input).dispatch([1, 1, 1])),
        "Pass [p] binds [input] as [b0], which the kernel declares as a buffer."
    );
}

fn verify_error_after(damage: impl FnOnce(&mut Plan)) -> String {
    let mut plan = compile(window());
    assert_eq!(verify(&plan), Ok(()));
    damage(&mut plan);
    verify(&plan).unwrap_err().to_string()
}

#[test]
fn damaged_layouts_are_rejected() {
    assert_eq!(
        verify_error_after(|plan| plan.entry.clear()),
        "Pass [show] uses image [image] in the layout Undefined, which does not allow it."
    );
    assert_eq!(
        verify_error_after(|plan| plan.exit.clear()),
        "Image [image] is left TransferTarget, but its exit state is Present."
    );
    assert_eq!(
        verify_error_after(|plan| plan.exit[0].from = ImageState::General),
        "The barrier at the end of the plan changes image [image] from General, but its layout is TransferTarget."
    );
    assert_eq!(
        verify_error_after(|plan| plan.homes[1] = Some(ImageState::General)),
        "Image [image] has home layout General, but is in TransferTarget."
    );
    assert_eq!(
        verify_error_after(|plan| plan.entry[0].image = ImageMemory::Slot(3)),
        "The barrier at the beginning of the plan changes the layout of image slot 3, which does not exist."
    );
    assert_eq!(
        verify_error_after(|plan| plan.groups[0].barrier = None),
        "Pass [layout transition] on buffer [image] has a write after write with pass [other commands on the queue] on \
         buffer [image] at byte 0 within 1 replay(s), but no barrier makes outside wait for the read."
    );
    let mut plan = compile(chain());
    plan.placements[1] = Some(7);
    let error = verify(&plan).unwrap_err().to_string();
    assert_eq!(error, "Transient image [a] is placed in slot 7, which does not exist or has another size or format.");
}
