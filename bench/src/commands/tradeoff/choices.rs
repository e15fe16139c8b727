//! The choices, and the settings that make them.

use sgs_passes::splat::BackwardKernel;
use sgs_passes::{Accuracy, Tuning};

/// One way to do it.
#[derive(Clone, Debug)]
pub struct Choice {
    /// Short.
    pub name: String,
    /// As a user would ask for it.
    pub setting: String,
    /// Sizes of kernels, and accuracy.
    pub tuning: Tuning,
    /// Backward of blending.
    pub backward: BackwardKernel,
    /// Whether Adam moves Gaussians that a step did not see.
    pub dense_adam: bool,
}

/// `exact` first, then every choice alone, then the presets; those of features where there are some.
pub fn choices(own: Tuning, semantics: bool) -> Vec<Choice> {
    let exact = Accuracy::EXACT;
    let mut all = Vec::new();
    let mut add = |name: &str, setting: &str, a: Accuracy| {
        all.push(Choice {
            name: name.to_owned(),
            setting: setting.to_owned(),
            tuning: own.with(a),
            backward: BackwardKernel::Pixel,
            dense_adam: false,
        });
    };
    add("exact", "`--accuracy exact`", exact);
    for bits in [24, 16] {
        let name = format!("depth of {bits} bits");
        add(&name, &format!("`accuracy.depth_bits={bits}`"), Accuracy { depth_bits: bits, ..exact });
    }
    for parts in [128.0_f32, 64.0, 32.0] {
        let name = format!("alpha from 1/{parts}");
        add(&name, &format!("`accuracy.alpha_min={:.5}`", 1.0 / parts), Accuracy { alpha_min: 1.0 / parts, ..exact });
    }
    add("last splat kept", "`accuracy.keep_last=true`", Accuracy { keep_last: true, ..exact });
    for least in [1e-3_f32, 1e-2, 5e-2] {
        let name = format!("transmittance to {least}, last splat kept");
        let setting = format!("`accuracy.transmittance_min={least}`, `accuracy.keep_last=true`");
        add(&name, &setting, Accuracy { transmittance_min: least, keep_last: true, ..exact });
    }
    add("cubic for exp", "`accuracy.fast_exp=true`", Accuracy { fast_exp: true, ..exact });
    add("colors in 16 bits", "`accuracy.color_bits=16`", Accuracy { color_bits: 16, ..exact });
    if semantics {
        add("features in 16 bits", "`accuracy.feature_bits=16`", Accuracy { feature_bits: 16, ..exact });
    }
    add("balanced", "`--accuracy balanced`", Accuracy::BALANCED);
    add("fast", "`--accuracy fast`", Accuracy::FAST);
    if semantics {
        let setting = "`--accuracy fast`, `accuracy.feature_bits=16`";
        add("fast, features in 16 bits", setting, Accuracy { feature_bits: 16, ..Accuracy::FAST });
    }
    let [width, height] = own.tile;
    for rows in [height / 2, height * 2] {
        let tuning = Tuning { tile: [width, rows], ..own };
        let (name, setting) = (format!("tiles of {width}x{rows}"), format!("`train.tile_rows={rows}`"));
        all.push(Choice { name, setting, tuning, backward: BackwardKernel::Pixel, dense_adam: false });
    }
    all.push(Choice {
        name: "backward by splats".to_owned(),
        setting: "`geometry.backward=splat`".to_owned(),
        tuning: own,
        backward: BackwardKernel::Splat,
        dense_adam: false,
    });
    all.push(Choice {
        name: "backward by atomics".to_owned(),
        setting: "`geometry.backward=atomic`".to_owned(),
        tuning: own,
        backward: BackwardKernel::Atomic,
        dense_adam: false,
    });
    all.push(Choice {
        name: "Adam of all".to_owned(),
        setting: "`geometry.dense_adam=true`".to_owned(),
        tuning: own,
        backward: BackwardKernel::Pixel,
        dense_adam: true,
    });
    all
}
