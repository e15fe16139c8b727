//! Graph of a shaded view.

use super::{Lighting, LitLayer, LitOptions, LitScene};
use crate::Tuning;
use crate::kernel::{groups, stage};
use crate::pipeline::transport::{Declared, Terms};
use crate::pipeline::{ShadedVisibility, Step};
use crate::scene::{Handles, Trainable, TrainableHandles};
use crate::shade::environment::{
    EnvironmentTables, EnvironmentView, Filtered, environment as ambient_light, environment_background,
    environment_diffuse,
};
use crate::shade::lights::{LightParameters, Lights, Shape, lights, lights_prepare, lights_split};
use crate::shade::traced::{Traced, lights_split_traced};
use crate::shade::visibility::{FieldHandles, View as VisibilityView, lights_field, lights_split_field, visibility};
use crate::shade::{
    ALBEDO_RANGE, GBUFFER_CHANNELS, PixelMaterials, Pixels, RawMaterials, Room, Rows, Surfaces, gbuffer, materials,
    values, weight_rows,
};
use crate::splat::{Blended, Channels, Present, Screen, blend, intersect, present_light, project};
use sgs_engine::Result;
use sgs_engine::graph::{Buffer, CompileOptions, Graph, GraphError, Image, Plan};
use sgs_shaders::lit_layer as kernel;
use sgs_shaders::structs::{FieldStep, LitStep};
use std::sync::Arc;

/// Compiled plan and its handles.
pub(super) struct Built {
    pub plan: Arc<Plan>,
    pub step: Buffer,
    pub lit: Buffer,
    pub image: Image,
    pub gaussians: Handles,
    /// Albedo, roughness, metallic.
    pub materials: Vec<TrainableHandles>,
    pub lights: Option<LightParameters>,
    pub field: Option<FieldHandles>,
    pub tree: Option<Traced>,
    pub environment: Option<EnvironmentBuffers>,
    pub transport: Option<Declared>,
    /// View statistics (frames, incomplete frames, required entries); required weights.
    pub report: [Buffer; 2],
}

/// Handles of the environment map.
#[derive(Clone, Copy)]
pub(super) struct EnvironmentBuffers {
    pub tables: EnvironmentTables,
    pub texels: TrainableHandles,
    pub radiance: Buffer,
}

/// Buffers that a layer is composed of; the kernel treats absent terms as zero.
struct Parts {
    direct: Option<Buffer>,
    ambient: Option<Buffer>,
    rest: [Option<Buffer>; 2],
    environment_map: Option<Buffer>,
    /// Buffer, then floats per pixel, first channel shown and number of channels shown.
    values: Option<(Buffer, [u32; 3])>,
}

/// Builds the plan for this capacity of entries and weights.
pub(super) fn build(
    t: &Tuning,
    scene: &LitScene,
    lighting: &Lighting,
    options: &LitOptions,
    capacity: [u32; 2],
) -> Result<Built> {
    let mut g = Graph::new("lit_view");
    let step = g.uniform("step", size_of::<Step>() as u64);
    let lit = g.uniform("lit", size_of::<LitStep>() as u64);
    let report = [g.external("view_report", 12), g.external("weights_report", 4)];
    let (layer, format) = (options.layer, options.format);
    let image = g.external_image("target", options.size, format.into(), options.entry, options.exit);
    let screen = Screen { step, largest: options.size, tile: t.tile };
    let pixels = screen.pixels();
    let s = &scene.scene;
    let gaussians = s.gaussians.declare(&mut g, false);
    let flags = g.transient("flags", 4);
    g.fill("clear_flags", flags, 0)?;

    // Surfaces.
    let visible = project(&mut g, t, &screen, &gaussians, GBUFFER_CHANNELS)?;
    let entries = intersect(&mut g, t, &screen, &visible, capacity[0], flags)?;
    let blended = Blended {
        image: g.transient("blended", 4 * u64::from(GBUFFER_CHANNELS.count()) * pixels),
        transmittance: g.transient("blended_transmittance", 4 * pixels),
    };
    blend(&mut g, t, &screen, &visible, &entries, &blended)?;
    let floats = |g: &mut Graph, name: &str, each: u64| g.transient(name, 4 * each * pixels);
    let surfaces = Surfaces {
        points: floats(&mut g, "points", 3),
        normals: floats(&mut g, "normals", 3),
        coverage: floats(&mut g, "coverage", 1),
    };
    gbuffer(&mut g, t, &screen, &blended, &surfaces)?;
    let words = 4 * u64::from(capacity[1]);
    let rows = Rows {
        row_starts: g.transient("row_starts", 4 * (pixels + 1)),
        columns: g.transient("columns", words),
        weights: g.transient("weights", words),
        bits: 32,
    };
    let wanted = g.transient("weights_wanted", 4);
    let room = Room { capacity: capacity[1], gaussians: s.gaussians.capacity, flags, wanted };
    weight_rows(&mut g, t, &screen, &visible, &entries, surfaces.coverage, &room, &rows)?;

    // Materials.
    let take = |g: &mut Graph, name, trained: &Trainable| Trainable::handles(g, name, trained.floats(), false);
    let mut of = vec![take(&mut g, "albedo", &s.albedo), take(&mut g, "roughness", &s.roughness)];
    of.extend(s.metallic.as_ref().map(|m| take(&mut g, "metallic", m)));
    let metallic = of.get(2).map(|m| m.parameters);
    let raw =
        RawMaterials { albedo_range: ALBEDO_RANGE, albedo: of[0].parameters, roughness: of[1].parameters, metallic };
    let of_gaussians = values(&mut g, t, &raw, s.gaussians.capacity)?;
    let shown = PixelMaterials {
        materials: floats(&mut g, "materials", 4),
        metallic: metallic.map(|_| floats(&mut g, "metallic_of_pixels", 1)),
    };
    materials(&mut g, t, &screen, &of_gaussians, rows, &shown)?;
    let seen = Pixels { screen, surfaces, materials: shown };

    // Light.
    let mut parts = Parts { direct: None, ambient: None, rest: [None; 2], environment_map: None, values: None };
    let transport = s.transport.as_ref().filter(|_| layer.direct());
    let wants_lights = s.transport.is_none() && (layer.direct() || layer == LitLayer::Visibility);
    let (mut field, mut tree) = (None, None);
    match s.visibility.as_ref().filter(|_| wants_lights) {
        Some(ShadedVisibility::Field { field: learned, .. }) => field = Some(learned.declare(&mut g, false)),
        Some(ShadedVisibility::Traced { shape, .. }) => tree = Some(Traced::declare(&mut g, shape)),
        None => {}
    }
    let mut light_buffers = None;
    if wants_lights {
        let m = lighting.model;
        let [positions, lobes, gains] =
            [("light_positions", m.position_bytes()), ("light_lobes", m.lobe_bytes()), ("light_gains", m.gain_bytes())]
                .map(|(name, bytes)| g.uniform(name, bytes));
        let parameters = LightParameters { positions, lobes, gains };
        light_buffers = Some(parameters);
        if layer == LitLayer::Visibility && tree.is_none() {
            if let Some(f) = &field {
                let into = floats(&mut g, "visibility", 1);
                let (points, coverage) = (surfaces.points, surfaces.coverage);
                let view = VisibilityView { pixels: pixels as u32, points, coverage, lights: positions };
                visibility(&mut g, *t, &f.field, &view, None, true, into)?;
                parts.values = Some((into, [1, 0, 1]));
            }
        } else {
            let prepared = lights_prepare(&mut g, *t, "lights_prepare", step, m, &parameters, None)?;
            let shape = Shape::for_device(*t);
            let light_table = Lights { pixels: seen, prepared, normalizer: lighting.normalizer, shape };
            let direct = floats(&mut g, "direct", 3);
            let diffuse = (layer.split() || tree.is_some()).then(|| floats(&mut g, "direct_diffuse", 3));
            match (&tree, &field, diffuse) {
                (Some(traced), _, Some(diffuse)) => {
                    let into = floats(&mut g, "visibility", 1);
                    lights_split_traced(&mut g, *t, &light_table, traced, [direct, diffuse], into)?;
                    parts.values = (layer == LitLayer::Visibility).then_some((into, [1, 0, 1]));
                }
                (_, Some(f), Some(diffuse)) => lights_split_field(&mut g, *t, &light_table, &f.field, direct, diffuse)?,
                (_, Some(f), None) => lights_field(&mut g, *t, &light_table, &f.field, direct)?,
                (_, None, Some(diffuse)) => lights_split(&mut g, &light_table, direct, diffuse)?,
                (_, None, None) => lights(&mut g, &light_table, direct)?,
            }
            parts.direct = match layer {
                LitLayer::Visibility => None,
                LitLayer::Diffuse => diffuse,
                _ => Some(direct),
            };
            parts.rest[0] = diffuse.filter(|_| layer == LitLayer::Specular);
        }
    }
    let mut declared_transport = None;
    if let Some(transport) = transport {
        let declared = transport.declare(&mut g);
        let terms =
            Terms { each: ["light_diffuse", "light_specular", "indirect", "emission"].map(|n| floats(&mut g, n, 3)) };
        let all = transport.shade(&mut g, t, &declared, (&seen, rows), &terms)?;
        let [diffuse, specular, ..] = terms.each;
        (parts.direct, parts.ambient) = match layer {
            LitLayer::Diffuse => (Some(diffuse), None),
            LitLayer::Specular => (Some(specular), None),
            LitLayer::Direct => (Some(diffuse), Some(specular)),
            _ => (Some(all), None),
        };
        declared_transport = Some(declared);
    }
    let mut environment = None;
    if let Some(e) = scene.environment.as_ref().filter(|_| layer.ambient()) {
        let tables = e.source.tables.declare(&mut g);
        let texels = take(&mut g, "texels", &e.source.texels);
        let radiance = g.input("environment_radiance", e.radiance.bytes());
        environment = Some(EnvironmentBuffers { tables, texels, radiance });
        let (filtered, view) = (Filtered::from_radiance(radiance), EnvironmentView::from(&seen));
        if layer != LitLayer::Diffuse {
            let ambient = floats(&mut g, "ambient", 3);
            ambient_light(&mut g, t, &e.source.tables, &tables, &view, &filtered, ambient)?;
            parts.ambient = Some(ambient);
        }
        if layer.split() {
            let diffuse = floats(&mut g, "ambient_diffuse", 3);
            environment_diffuse(&mut g, t, &e.source.tables, &tables, &view, &filtered, diffuse)?;
            let place = if layer == LitLayer::Diffuse { &mut parts.ambient } else { &mut parts.rest[1] };
            *place = Some(diffuse);
        }
        if layer == LitLayer::Environment {
            let behind = floats(&mut g, "environment_background", 3);
            environment_background(&mut g, t, &e.source.tables, step, pixels, texels.parameters, behind)?;
            parts.environment_map = Some(behind);
        }
    }
    match layer {
        LitLayer::Albedo => parts.values = Some((shown.materials, [4, 0, 3])),
        LitLayer::Roughness => parts.values = Some((shown.materials, [4, 3, 1])),
        LitLayer::Metallic => parts.values = shown.metallic.map(|m| (m, [1, 0, 1])),
        _ => {}
    }

    // Output.
    let into = Blended { image: floats(&mut g, "image", 3), transmittance: floats(&mut g, "transmittance", 1) };
    let of_view = [surfaces.coverage, blended.transmittance];
    let of_step = LayerBuffers { of_view, lit, flags, wanted, most: report[1] };
    put_together(&mut g, t, &screen, layer, &parts, &of_step, &into)?;
    let texels = g.transient("texels_of_image", format.bytes() * pixels);
    let channels = Channels { colors: true, normals: false, depth: false };
    let wanted = entries.wanted.into();
    let what = Present { blended: into, channels, flags, wanted, texels, report: report[0] };
    let encoding = (!layer.is_value()).then_some(options.encoding);
    present_light(&mut g, t, &screen, &what, format, encoding)?;
    g.copy_to_image("copy_to_target", texels, image)?;
    let plan = Arc::new(g.compile(&CompileOptions::default())?);
    Ok(Built {
        plan,
        step,
        lit,
        image,
        gaussians,
        materials: of,
        lights: light_buffers,
        field,
        tree,
        environment,
        transport: declared_transport,
        report,
    })
}

/// Buffers of a step that the layer is composed from.
struct LayerBuffers {
    /// Coverage and transmittance of the view.
    of_view: [Buffer; 2],
    lit: Buffer,
    flags: Buffer,
    wanted: Buffer,
    most: Buffer,
}

/// Composes the layer from its terms.
fn put_together(
    g: &mut Graph,
    t: &Tuning,
    screen: &Screen,
    layer: LitLayer,
    parts: &Parts,
    buffers: &LayerBuffers,
    into: &Blended,
) -> std::result::Result<(), GraphError> {
    let &LayerBuffers { of_view: [coverage, blended], lit, flags, wanted, most } = buffers;
    // A specialized kernel never reads absent terms, but each binding needs a buffer.
    let or_any = |buffer: Option<Buffer>| buffer.unwrap_or(coverage).into();
    let bindings = kernel::Bindings {
        params: screen.step.into(),
        lit: lit.into(),
        coverage: coverage.into(),
        blended: blended.into(),
        direct: or_any(parts.direct),
        ambient: or_any(parts.ambient),
        direct_rest: or_any(parts.rest[0]),
        ambient_rest: or_any(parts.rest[1]),
        background: or_any(parts.environment_map),
        values: or_any(parts.values.map(|v| v.0)),
        flags: flags.into(),
        required: wanted.into(),
        image: into.image.into(),
        transmittance: into.transmittance.into(),
        most: most.into(),
    };
    let [stride, first, count] = parts.values.map_or([0, 0, 1], |v| v.1);
    let behind = match layer {
        LitLayer::Shaded => 1,
        LitLayer::Environment if parts.environment_map.is_some() => 2,
        _ => 0,
    };
    let specs = kernel::Specs {
        workgroup: t.workgroup,
        direct: parts.direct.is_some(),
        ambient: parts.ambient.is_some(),
        rest: parts.rest.iter().any(Option::is_some),
        behind,
        stride,
        first,
        count,
    };
    stage(g, "lit_layer", &kernel::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch(groups(screen.pixels(), t.workgroup))
}

/// Returns the uniform of the visibility field for a view.
pub(super) fn field_step(scene: &LitScene, lighting: &Lighting, size: [u32; 2]) -> FieldStep {
    let pixels = size[0] * size[1];
    let place = match &scene.scene.visibility {
        Some(ShadedVisibility::Field { place, .. }) => *place,
        _ => FieldStep::default(),
    };
    FieldStep { pixels, lights: lighting.count, ..place }
}
