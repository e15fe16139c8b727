//! Process that compiles kernels with one driver.
//!
//! It reads jobs and writes answers, one JSON value per line. The first answer describes the device.

use super::Job;
use serde::{Deserialize, Serialize};
use sgs_engine::device::Objects;
use sgs_engine::shader::Shader;
use sgs_engine::{CompileOnlyDevice, MatrixShape};
use sgs_passes::kernel::shader;
use std::collections::BTreeMap;
use std::io::{BufRead, Write};
use std::sync::Arc;

/// Device of a worker.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Gpu {
    /// Name by the driver.
    pub name: String,
    /// Name and version of the driver.
    pub driver: String,
    /// Smallest and largest subgroup size.
    pub subgroup_sizes: (u32, u32),
    /// Shared memory of a workgroup in bytes.
    pub max_shared_bytes: u32,
    /// Whether 32-bit floats are added atomically.
    pub float_atomics: bool,
    /// Rows, columns and depth of each shape of cooperative matrices.
    pub matrices: Vec<[u32; 3]>,
}

impl Gpu {
    /// Returns the shapes of cooperative matrices.
    pub fn shapes(&self) -> Vec<MatrixShape> {
        self.matrices.iter().map(|&[rows, columns, depth]| MatrixShape { rows, columns, depth }).collect()
    }
}

/// Answer of a worker.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Answer {
    /// Device, before the first job.
    Gpu(Gpu),
    /// Statistics of a compiled kernel, by the driver's names.
    Compiled(BTreeMap<String, f64>),
    /// Sentence why there is no device, or why the driver rejects a kernel.
    Refused(String),
}

/// Answers jobs until standard input ends.
///
/// # Errors
/// If a job cannot be read, or an answer cannot be written.
pub fn run() -> anyhow::Result<()> {
    let objects = Objects::default();
    let device = match CompileOnlyDevice::open(None, objects.clone()) {
        Ok(device) => device,
        Err(error) => return answer(&Answer::Refused(error.to_string())),
    };
    let info = device.info();
    answer(&Answer::Gpu(Gpu {
        name: info.name.clone(),
        driver: info.driver.trim().to_owned(),
        subgroup_sizes: info.subgroup_sizes,
        max_shared_bytes: info.max_shared_bytes,
        float_atomics: info.optional.float_atomics,
        matrices: info.matrices.iter().map(|m| [m.rows, m.columns, m.depth]).collect(),
    }))?;
    let kernels: BTreeMap<&str, Arc<Shader>> = sgs_shaders::ALL.iter().map(|k| (k.name, shader(k))).collect();
    for line in std::io::stdin().lock().lines() {
        let job: Job = serde_json::from_str(&line?)?;
        let compiled = match kernels.get(job.kernel.as_str()) {
            Some(shader) => device.compile(shader, &job.specs, Some(job.lanes)),
            None => anyhow::bail!("No kernel is called \"{}\".", job.kernel),
        };
        answer(&match compiled {
            // Hashes identify builds of the driver and say nothing of the kernel.
            Ok(found) => Answer::Compiled(
                found
                    .statistics
                    .into_iter()
                    .filter(|s| !s.name.to_lowercase().contains("hash"))
                    .map(|s| (s.name, s.value))
                    .collect(),
            ),
            Err(error) => Answer::Refused(error.to_string()),
        })?;
    }
    drop(device);
    anyhow::ensure!(objects.total() == 0, "Objects are left: {:?}.", objects.alive());
    Ok(())
}

fn answer(answer: &Answer) -> anyhow::Result<()> {
    let mut out = std::io::stdout().lock();
    serde_json::to_writer(&mut out, answer)?;
    out.write_all(b"\n")?;
    Ok(out.flush()?)
}
