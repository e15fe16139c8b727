//! GLSL to SPIR-V: finds the kernels of a folder, resolves `#include`, compiles and reflects each.

use crate::reflect::{Kernel, reflect};
use std::path::{Path, PathBuf};

/// Why a kernel could not be built.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The compiler could not be set up.
    #[error("The GLSL compiler could not be started: {0}.")]
    Compiler(String),
    /// A file could not be read.
    #[error("\"{0}\" could not be read: {1}.")]
    Read(PathBuf, std::io::Error),
    /// The GLSL is wrong.
    #[error("Kernel \"{0}\" does not compile:\n{1}")]
    Glsl(String, String),
    /// The SPIR-V cannot be expressed on the host side.
    #[error("Kernel \"{0}\" cannot be reflected: {1}.")]
    Reflect(String, String),
}

/// Compiles every `family/NAME.comp` below `root`; `#include "x.glsl"` is looked up in `root/include`.
/// Kernels come back sorted by name.
pub fn compile_folder(root: &Path) -> Result<Vec<Kernel>, Error> {
    let mut files = Vec::new();
    for family in list(root)? {
        if family.is_dir() && !["src", "compiler", "include", "target"].iter().any(|s| family.ends_with(s)) {
            files.extend(list(&family)?.into_iter().filter(|f| f.extension().is_some_and(|e| e == "comp")));
        }
    }
    files.sort_by(|a, b| a.file_stem().cmp(&b.file_stem()));
    let compiler = shaderc::Compiler::new().map_err(|e| Error::Compiler(e.to_string()))?;
    files.iter().map(|f| compile(&compiler, &root.join("include"), f)).collect()
}

fn list(folder: &Path) -> Result<Vec<PathBuf>, Error> {
    let read = |e| Error::Read(folder.to_owned(), e);
    let mut paths = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(read)? {
        paths.push(entry.map_err(read)?.path());
    }
    paths.sort();
    Ok(paths)
}

fn compile(compiler: &shaderc::Compiler, include: &Path, file: &Path) -> Result<Kernel, Error> {
    let source = std::fs::read_to_string(file).map_err(|e| Error::Read(file.to_owned(), e))?;
    let stem = |p: &Path| p.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let name = stem(file);
    let family = file.parent().map(stem).unwrap_or_default();
    let mut options = shaderc::CompileOptions::new().map_err(|e| Error::Compiler(e.to_string()))?;
    options.set_target_env(shaderc::TargetEnv::Vulkan, shaderc::EnvVersion::Vulkan1_3 as u32);
    // 1.5 rather than 1.6: local sizes stay a plain specialization constant, which every reflector understands.
    options.set_target_spirv(shaderc::SpirvVersion::V1_5);
    options.set_auto_bind_uniforms(true);
    options.set_warnings_as_errors();
    options.set_include_callback(|wanted, _, _, _| {
        let path = include.join(wanted);
        let content = std::fs::read_to_string(&path).map_err(|e| format!("{}: {e}", path.display()))?;
        Ok(shaderc::ResolvedInclude { resolved_name: path.to_string_lossy().into_owned(), content })
    });
    let artifact = compiler
        .compile_into_spirv(&source, shaderc::ShaderKind::Compute, &file.to_string_lossy(), "main", Some(&options))
        .map_err(|e| Error::Glsl(name.clone(), e.to_string()))?;
    reflect(name.clone(), family, artifact.as_binary()).map_err(|e| Error::Reflect(name, e))
}
