//! Conversion of generated kernels to passes of a graph.

use sgs_engine::graph::{Graph, PassBuilder, Slice};
use sgs_engine::shader::Shader;
use sgs_shaders::Kernel;
use std::borrow::Cow;
use std::sync::Arc;

/// Returns the engine's description of a generated kernel.
pub fn shader(kernel: &'static Kernel) -> Arc<Shader> {
    Arc::new(Shader {
        name: Cow::Borrowed(kernel.name),
        spirv: Cow::Borrowed(kernel.spirv.words()),
        bindings: kernel.bindings.to_vec(),
        push_bytes: kernel.push_bytes,
        specs: kernel.specs.to_vec(),
    })
}

/// Starts a pass of `graph` that runs `kernel` with all inputs set. The caller adds the size of the dispatch.
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

/// Starts a pass of `graph` that runs `kernel`. The caller binds the buffers.
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

/// Returns the workgroups along x, y and z for `count` items of `per_group` each. Counts above 65535 are folded into y.
pub fn groups(count: u64, per_group: u32) -> [u32; 3] {
    let n = count.div_ceil(u64::from(per_group)).max(1);
    let x = n.min(65535);
    [x as u32, n.div_ceil(x) as u32, 1]
}

/// Builds specialization constants of a kernel that includes `splat.glsl`. They follow the accuracy of the tuning.
macro_rules! splat_specs {
    ($kernel:ident, $tuning:expr, { $($field:tt)* }) => {
        $kernel::Specs {
            $($field)*
            alpha_min: $tuning.accuracy.alpha_min,
            transmittance_min: $tuning.accuracy.transmittance_min,
            keep_last: $tuning.accuracy.keep_last,
        }
    };
}
pub(crate) use splat_specs;
