//! Parameters and inputs of an intrinsic step, and their sizes.

use super::{IntrinsicOptions, StoredEnvironment, transport};
use crate::pipeline::TransportMemory;
use crate::scene::{Trainable, TrainableHandles};
use crate::shade::environment::{Environment, EnvironmentTables};
use crate::shade::lights::LightModel;
use crate::shade::traced::{Traced, TracedMemory};
use crate::shade::visibility::{FieldHandles, VisibilityField};
use sgs_engine::exec::Executor;
use sgs_engine::graph::{Buffer, Graph};
use sgs_engine::{Device, DeviceBuffer, Location, Result};

/// Trained parameters of the lights.
#[derive(Debug)]
pub struct LightTrainables {
    /// Positions.
    pub positions: Trainable,
    /// Lobes.
    pub lobes: Trainable,
}

/// Trained parameters of physical lights and of the room.
#[derive(Debug)]
pub struct TransportTrainables {
    /// Logarithms of the lights' colors, 3 floats per light.
    pub log_colors: Trainable,
    /// Raw albedo of the faces of the enclosure, 3 floats each: the inverse of the logistic function.
    pub enclosure: Trainable,
    /// Logarithms of the Gaussians' gains on the light that arrives, 1 float each.
    pub log_gains: Trainable,
}

/// Parameters trained in the intrinsic stage.
#[derive(Debug)]
pub struct IntrinsicParameters {
    /// Raw albedo, 3 floats per Gaussian.
    pub albedo: Trainable,
    /// Raw roughness, 1 float per Gaussian.
    pub roughness: Trainable,
    /// Raw metallic, 1 float per Gaussian, if trained.
    pub metallic: Option<Trainable>,
    /// Lights.
    pub lights: Option<LightTrainables>,
    /// Texels of the environment map.
    pub environment: Option<Trainable>,
    /// Visibility field.
    pub visibility: Option<VisibilityField>,
    /// Normals, 3 floats per Gaussian, if trained.
    pub normals: Option<Trainable>,
    /// Physical lights and the room.
    pub transport: Option<TransportTrainables>,
}

impl IntrinsicParameters {
    /// Returns all parameters except the field, in a fixed order.
    pub fn all(&self) -> Vec<&Trainable> {
        let mut all = vec![&self.albedo, &self.roughness];
        all.extend(&self.metallic);
        all.extend(self.lights.iter().flat_map(|l| [&l.positions, &l.lobes]));
        all.extend(&self.environment);
        all.extend(&self.normals);
        all.extend(self.transport.iter().flat_map(|t| [&t.log_colors, &t.enclosure, &t.log_gains]));
        all
    }
}

/// Device memory of an intrinsic step, besides the surfaces of a view.
pub struct IntrinsicInputs<'a> {
    /// Trained parameters.
    pub parameters: &'a IntrinsicParameters,
    /// Gains of the lights; 0 switches one off.
    pub gains: Option<&'a DeviceBuffer>,
    /// Environment map: its filter tables and their device memory.
    pub environment: Option<(&'a Environment, &'a EnvironmentMemory)>,
    /// Mip levels of the environment map, unless every step updates it.
    pub stored: Option<&'a StoredEnvironment>,
    /// Tree for traced visibility.
    pub traced: Option<&'a TracedMemory>,
    /// Room of the physical lights.
    pub transport: Option<&'a TransportMemory>,
    /// Photographs, and what is packed like them.
    pub images: ViewImages<'a>,
    /// Region ids of the training views ([`crate::loss::pack_regions`]).
    ///
    /// With [`crate::pipeline::Masks::Provided`], masks of the step's views.
    pub regions: Option<&'a DeviceBuffer>,
    /// Region ids of the pseudo-views, for [`crate::pipeline::Masks::Numbered`].
    pub pseudo_regions: Option<&'a DeviceBuffer>,
}

/// Photographs of some training views, with their priors and estimates.
#[derive(Clone, Copy, Debug)]
pub struct ViewImages<'a> {
    /// Photographs, packed.
    pub targets: &'a DeviceBuffer,
    /// Albedo priors, packed like the photographs.
    pub albedo: Option<&'a DeviceBuffer>,
    /// Roughness priors, packed likewise.
    pub roughness: Option<&'a DeviceBuffer>,
    /// Metallic priors, packed likewise.
    pub metallic: Option<&'a DeviceBuffer>,
    /// Estimates of the materials under other lights, packed like the priors.
    ///
    /// Albedo of each copy of the lights, then roughness of each copy.
    pub estimates: [Option<&'a DeviceBuffer>; 2 * COPIES],
}

/// Maximum number of copies of the lights in a step.
pub const COPIES: usize = 2;

/// Buffer names of the estimates.
const ESTIMATES: [&str; 2 * COPIES] = ["relit_albedo0", "relit_albedo1", "relit_roughness0", "relit_roughness1"];

/// Filter tables of an environment map in device memory.
#[derive(Debug)]
pub struct EnvironmentMemory(Vec<DeviceBuffer>);

impl EnvironmentMemory {
    /// Uploads the tables.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn new(device: &Device, environment: &Environment) -> Result<EnvironmentMemory> {
        // This graph never runs. Its handles only label the contents.
        let mut g = Graph::new("tables");
        let tables = environment.declare(&mut g);
        let put = |(_, bytes): (Buffer, Vec<u8>)| {
            let buffer = device.buffer("environment_table", bytes.len() as u64, Location::Device)?;
            device.upload(&buffer, 0, &bytes)?;
            Ok(buffer)
        };
        Ok(EnvironmentMemory(environment.contents(&tables).into_iter().map(put).collect::<Result<_>>()?))
    }

    /// Returns the bytes of the tables.
    pub fn bytes_of(environment: &Environment) -> u64 {
        let mut g = Graph::new("tables");
        let tables = environment.declare(&mut g);
        environment.contents(&tables).iter().map(|(_, bytes)| bytes.len() as u64).sum()
    }

    /// Binds the tables to their handles.
    ///
    /// # Errors
    /// If the plan was compiled for another environment map.
    pub fn bind(&self, exec: &mut Executor, environment: &Environment, tables: &EnvironmentTables) -> Result<()> {
        let handles = environment.contents(tables);
        handles.iter().zip(&self.0).try_for_each(|((handle, _), buffer)| exec.bind(*handle, buffer))
    }
}

/// Sizes of [`IntrinsicInputs`], to compile a plan without them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct IntrinsicSizes {
    /// Bytes of the photographs.
    pub targets: u64,
    /// Bytes of the albedo priors.
    pub albedo: Option<u64>,
    /// Bytes of the roughness priors.
    pub roughness: Option<u64>,
    /// Bytes of the metallic priors.
    pub metallic: Option<u64>,
    /// Bytes of the regions.
    pub regions: Option<u64>,
    /// Bytes of the regions of the pseudo-views.
    pub pseudo_regions: Option<u64>,
    /// Bytes of the estimates.
    pub estimates: [Option<u64>; 2 * COPIES],
}

impl IntrinsicInputs<'_> {
    /// Returns the sizes of the inputs.
    pub fn sizes(&self) -> IntrinsicSizes {
        IntrinsicSizes {
            targets: self.images.targets.bytes(),
            albedo: self.images.albedo.map(DeviceBuffer::bytes),
            roughness: self.images.roughness.map(DeviceBuffer::bytes),
            metallic: self.images.metallic.map(DeviceBuffer::bytes),
            regions: self.regions.map(DeviceBuffer::bytes),
            pseudo_regions: self.pseudo_regions.map(DeviceBuffer::bytes),
            estimates: self.images.estimates.map(|e| e.map(DeviceBuffer::bytes)),
        }
    }

    pub(super) fn environment(&self) -> Option<&Environment> {
        self.environment.map(|(e, _)| e)
    }
}

/// Handles of the lights in a graph.
#[derive(Clone, Copy, Debug)]
pub(super) struct LightHandles {
    pub model: LightModel,
    pub normalizer: f32,
    pub positions: TrainableHandles,
    pub lobes: TrainableHandles,
    pub gains: Buffer,
}

/// Handles of all parameters and inputs in a graph.
#[derive(Clone, Copy, Debug)]
pub(super) struct Declared {
    pub albedo: TrainableHandles,
    pub roughness: TrainableHandles,
    pub metallic: Option<TrainableHandles>,
    pub lights: Option<LightHandles>,
    pub environment: Option<(TrainableHandles, EnvironmentTables)>,
    pub visibility: Option<FieldHandles>,
    pub normals: Option<TrainableHandles>,
    pub traced: Option<Traced>,
    pub transport: Option<transport::Declared>,
    pub targets: Buffer,
    pub albedo_priors: Option<Buffer>,
    pub roughness_priors: Option<Buffer>,
    pub metallic_priors: Option<Buffer>,
    pub regions: Option<Buffer>,
    pub pseudo_regions: Option<Buffer>,
    pub estimates: [Option<Buffer>; 2 * COPIES],
}

impl Declared {
    pub fn declare(
        g: &mut Graph,
        sizes: &IntrinsicSizes,
        tables: Option<(EnvironmentTables, u32)>,
        o: &IntrinsicOptions,
        table_bits: u32,
    ) -> Declared {
        let n = o.shape.gaussians;
        let mut learned = |name: &'static str, floats: u64| {
            Trainable::handles(g, name, u32::try_from(floats).unwrap_or(u32::MAX), true)
        };
        let albedo = learned("albedo", 3 * u64::from(n));
        let roughness = learned("roughness", n.into());
        let metallic = o.metallic.then(|| learned("metallic", n.into()));
        let lights = o.lights.map(|(model, _)| {
            (learned("light_positions", model.position_bytes() / 4), learned("light_lobes", model.lobe_bytes() / 4))
        });
        let normals = o.learns_normals().then(|| learned("gaussian_normals", 3 * u64::from(n)));
        let transport_parameters = o.transport.map(|t| {
            let colors = learned("light_log_colors", 3 * u64::from(t.shape.lights));
            [colors, learned("enclosure_albedo", 18), learned("log_gains", n.into())]
        });
        let environment = tables.map(|(tables, floats)| (learned("environment", floats.into()), tables));
        let lights = o.lights.zip(lights).map(|((model, normalizer), (positions, lobes))| LightHandles {
            model,
            normalizer,
            positions,
            lobes,
            gains: g.input("light_gains", model.gain_bytes()),
        });
        Declared {
            albedo,
            roughness,
            metallic,
            lights,
            environment,
            normals,
            visibility: o.visibility.map(|config| VisibilityField::handles(g, config, true, table_bits)),
            traced: o.traced.map(|shape| Traced::declare(g, &shape)),
            transport: o.transport.zip(transport_parameters).map(|(t, [log_colors, enclosure, log_gains])| {
                transport::Declared {
                    memory: t.shape.declare(g),
                    unit: g.input("view_light", o.view_light_bytes()),
                    log_colors,
                    enclosure,
                    log_gains,
                }
            }),
            targets: g.input("targets", sizes.targets),
            albedo_priors: sizes.albedo.map(|bytes| g.input("albedo_priors", bytes)),
            roughness_priors: sizes.roughness.map(|bytes| g.input("roughness_priors", bytes)),
            metallic_priors: sizes.metallic.map(|bytes| g.input("metallic_priors", bytes)),
            regions: sizes.regions.map(|bytes| g.input("regions", bytes)),
            pseudo_regions: sizes.pseudo_regions.map(|bytes| g.input("pseudo_regions", bytes)),
            estimates: std::array::from_fn(|i| sizes.estimates[i].map(|bytes| g.input(ESTIMATES[i], bytes))),
        }
    }

    pub fn bind(&self, exec: &mut Executor, inputs: &IntrinsicInputs<'_>) -> Result<()> {
        let p = inputs.parameters;
        p.albedo.bind(exec, &self.albedo)?;
        p.roughness.bind(exec, &self.roughness)?;
        if let (Some(memory), Some(handles)) = (&p.metallic, &self.metallic) {
            memory.bind(exec, handles)?;
        }
        if let (Some(lights), Some(handles), Some(gains)) = (&p.lights, &self.lights, inputs.gains) {
            lights.positions.bind(exec, &handles.positions)?;
            lights.lobes.bind(exec, &handles.lobes)?;
            exec.bind(handles.gains, gains)?;
        }
        if let (Some(texels), Some((handles, tables)), Some((environment, memory))) =
            (&p.environment, &self.environment, inputs.environment)
        {
            texels.bind(exec, handles)?;
            memory.bind(exec, environment, tables)?;
        }
        if let (Some(memory), Some(handles)) = (&p.normals, &self.normals) {
            memory.bind(exec, handles)?;
        }
        if let (Some(field), Some(handles)) = (&p.visibility, &self.visibility) {
            field.bind(exec, handles)?;
        }
        if let (Some(tree), Some(handles)) = (inputs.traced, &self.traced) {
            tree.bind(exec, handles)?;
        }
        if let (Some(memory), Some(parameters), Some(handles)) = (inputs.transport, &p.transport, &self.transport) {
            memory.bind(exec, &handles.memory)?;
            parameters.log_colors.bind(exec, &handles.log_colors)?;
            parameters.enclosure.bind(exec, &handles.enclosure)?;
            parameters.log_gains.bind(exec, &handles.log_gains)?;
        }
        self.images().pairs(&inputs.images).try_for_each(|(handle, memory)| exec.bind(handle, memory))?;
        for (handle, memory) in [(self.regions, inputs.regions), (self.pseudo_regions, inputs.pseudo_regions)] {
            if let (Some(handle), Some(memory)) = (handle, memory) {
                exec.bind(handle, memory)?;
            }
        }
        Ok(())
    }

    /// Returns the handles of photographs, priors and estimates.
    pub fn images(&self) -> ImageHandles {
        let priors = [self.albedo_priors, self.roughness_priors, self.metallic_priors];
        ImageHandles { targets: self.targets, priors, estimates: self.estimates }
    }
}

/// Handles of photographs, and of what is packed like them.
#[derive(Clone, Copy, Debug)]
pub(super) struct ImageHandles {
    targets: Buffer,
    priors: [Option<Buffer>; 3],
    estimates: [Option<Buffer>; 2 * COPIES],
}

impl ImageHandles {
    /// Returns the handles that the graph has, each with its memory.
    pub fn pairs<'a>(&self, images: &ViewImages<'a>) -> impl Iterator<Item = (Buffer, &'a DeviceBuffer)> + use<'a> {
        let priors = self.priors.into_iter().zip([images.albedo, images.roughness, images.metallic]);
        let others = priors.chain(self.estimates.into_iter().zip(images.estimates));
        let others = others.filter_map(|(handle, memory)| handle.zip(memory));
        std::iter::once((self.targets, images.targets)).chain(others)
    }
}
