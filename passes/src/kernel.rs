//! From a generated kernel to a pass of a graph.

use sgs_engine::ImageFormat;
use sgs_engine::graph::{Graph, PassBuilder, Slice};
use sgs_engine::shader::{Access, Binding, BindingKind, Shader, SpecConstant};
use sgs_shaders::Kernel;
use std::borrow::Cow;
use std::sync::Arc;

/// The engine's view of a generated kernel.
pub fn shader(kernel: &'static Kernel) -> Arc<Shader> {
    Arc::new(Shader {
        name: Cow::Borrowed(kernel.name),
        spirv: Cow::Borrowed(kernel.spirv.words()),
        bindings: kernel
            .bindings
            .iter()
            .map(|b| Binding {
                name: Cow::Borrowed(b.name),
                number: b.number,
                kind: match b.kind {
                    sgs_shaders::BindingKind::Storage => BindingKind::Storage,
                    sgs_shaders::BindingKind::Uniform => BindingKind::Uniform,
                    sgs_shaders::BindingKind::Image(format) => BindingKind::Image(match format {
                        sgs_shaders::ImageFormat::R32Float => ImageFormat::R32Float,
                        sgs_shaders::ImageFormat::R32Uint => ImageFormat::R32Uint,
                        sgs_shaders::ImageFormat::Rgba8Unorm => ImageFormat::Rgba8Unorm,
                        sgs_shaders::ImageFormat::Rgba16Float => ImageFormat::Rgba16Float,
                        sgs_shaders::ImageFormat::Rgba32Float => ImageFormat::Rgba32Float,
                    }),
                },
                access: match b.access {
                    sgs_shaders::Access::Read => Access::Read,
                    sgs_shaders::Access::Write => Access::Write,
                    sgs_shaders::Access::ReadWrite => Access::ReadWrite,
                    sgs_shaders::Access::Accumulate => Access::Accumulate,
                },
            })
            .collect(),
        push_bytes: kernel.push_bytes,
        specs: kernel
            .specs
            .iter()
            .map(|s| SpecConstant { name: Cow::Borrowed(s.name), id: s.id, default: s.default })
            .collect(),
    })
}

/// Starts a pass of `graph` that runs `kernel` with everything it needs but the size of the dispatch.
pub fn stage<'g>(
    graph: &'g mut Graph,
    name: &str,
    kernel: &'static Kernel,
    bindings: impl IntoIterator<Item = (&'static str, Slice)>,
    specs: impl IntoIterator<Item = (&'static str, u32)>,
    push: &[u8],
) -> PassBuilder<'g> {
    let mut pass = graph.pass(name, &shader(kernel)).bind_all(bindings).push(push);
    for (name, bits) in specs {
        pass = pass.spec(name, bits);
    }
    pass
}

/// Starts a pass of `graph` that runs `kernel`, with nothing bound yet.
pub fn stage_with<'g>(
    graph: &'g mut Graph,
    name: &str,
    kernel: &'static Kernel,
    specs: impl IntoIterator<Item = (&'static str, u32)>,
    push: &[u8],
) -> PassBuilder<'g> {
    let pass = graph.pass(name, &shader(kernel)).push(push);
    specs.into_iter().fold(pass, |pass, (name, bits)| pass.spec(name, bits))
}

/// The kernel that decides whether conditional passes run; for [`Graph::set_gate`].
pub fn gate() -> Arc<Shader> {
    shader(&sgs_shaders::gate::KERNEL)
}

/// Workgroups along x and y for `count` items of `per_group` each, folded past 65535.
pub fn groups(count: u64, per_group: u32) -> [u32; 3] {
    let n = count.div_ceil(u64::from(per_group)).max(1);
    let x = n.min(65535);
    [x as u32, n.div_ceil(x) as u32, 1]
}

/// Constants of a kernel that includes `splat.glsl`, with the accuracy asked for.
macro_rules! splat_specs {
    ($kernel:ident, $tuning:expr, { $($field:tt)* }) => {
        $kernel::Specs {
            $($field)*
            alpha_min: $tuning.accuracy.alpha_min,
            transmittance_min: $tuning.accuracy.transmittance_min,
            fast_exp: $tuning.accuracy.fast_exp,
            keep_last: $tuning.accuracy.keep_last,
        }
    };
}
pub(crate) use splat_specs;
