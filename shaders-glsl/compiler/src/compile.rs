//! GLSL to SPIR-V: finds, compiles and reflects the kernels of a folder.

use crate::reflect::{Kernel, reflect};
use std::path::{Path, PathBuf};

/// Reason why a kernel could not be built.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The compiler could not be set up.
    #[error("The GLSL compiler could not be started: {0}.")]
    Compiler(String),
    /// A file could not be read.
    #[error("\"{0}\" could not be read: {1}.")]
    Read(PathBuf, std::io::Error),
    /// The GLSL does not compile.
    #[error("Kernel \"{0}\" does not compile:\n{1}")]
    Glsl(String, String),
    /// The SPIR-V has an interface that the generated Rust cannot express.
    #[error("Kernel \"{0}\" cannot be reflected: {1}.")]
    Reflect(String, String),
}

/// GLSL extensions that some compilers in use lack.
///
/// A kernel that requires such an extension is omitted if the compiler lacks it. Every other kernel must compile.
pub const OPTIONAL_EXTENSIONS: [&str; 1] = ["GL_KHR_cooperative_matrix"];

/// Kernels of a folder, sorted by name.
pub struct Folder {
    /// Compiled kernels.
    pub kernels: Vec<Kernel>,
    /// Kernels that need an extension which this compiler lacks.
    pub absent: Vec<Absent>,
}

/// Kernel that was omitted.
pub struct Absent {
    /// File stem.
    pub name: String,
    /// Required extension that the compiler lacks, one of [`OPTIONAL_EXTENSIONS`].
    pub extension: &'static str,
}

/// Compiles every `family/NAME.comp` below `root`.
///
/// `#include "x.glsl"` is resolved in `root/include`.
///
/// # Errors
/// If a file cannot be read, or a kernel cannot be compiled or reflected. A kernel that requires an extension of
/// [`OPTIONAL_EXTENSIONS`] which the compiler lacks is not an error.
pub fn compile_folder(root: &Path) -> Result<Folder, Error> {
    let mut files = Vec::new();
    for family in list(root)? {
        if family.is_dir() && !["src", "compiler", "include", "target"].iter().any(|s| family.ends_with(s)) {
            files.extend(list(&family)?.into_iter().filter(|f| f.extension().is_some_and(|e| e == "comp")));
        }
    }
    files.sort_by(|a, b| a.file_stem().cmp(&b.file_stem()));
    let compiler = shaderc::Compiler::new().map_err(|e| Error::Compiler(e.to_string()))?;
    let unknown: Vec<&str> = OPTIONAL_EXTENSIONS.into_iter().filter(|e| !knows(&compiler, e)).collect();
    let mut folder = Folder { kernels: Vec::new(), absent: Vec::new() };
    for file in &files {
        let source = std::fs::read_to_string(file).map_err(|e| Error::Read(file.to_owned(), e))?;
        match required(&source).filter(|e| unknown.contains(e)) {
            Some(extension) => folder.absent.push(Absent { name: stem(file), extension }),
            None => folder.kernels.push(compile(&compiler, &root.join("include"), file, &source)?),
        }
    }
    Ok(folder)
}

/// Returns the extension of [`OPTIONAL_EXTENSIONS`] that a source requires, if any.
fn required(source: &str) -> Option<&'static str> {
    let words =
        |line: &str| line.split([' ', ':', '\t']).filter(|w| !w.is_empty()).map(str::to_owned).collect::<Vec<_>>();
    let is_required = |e: &&str| source.lines().any(|line| words(line) == ["#extension", e, "require"]);
    OPTIONAL_EXTENSIONS.into_iter().find(is_required)
}

/// Returns whether the compiler supports a GLSL extension.
fn knows(compiler: &shaderc::Compiler, extension: &str) -> bool {
    let source = format!("#version 460\n#extension {extension} : require\nvoid main() {{}}\n");
    let Ok(mut options) = shaderc::CompileOptions::new() else { return false };
    options.set_target_env(shaderc::TargetEnv::Vulkan, shaderc::EnvVersion::Vulkan1_3 as u32);
    compiler.compile_into_spirv(&source, shaderc::ShaderKind::Compute, "probe", "main", Some(&options)).is_ok()
}

fn stem(path: &Path) -> String {
    path.file_stem().unwrap_or_default().to_string_lossy().into_owned()
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

fn compile(compiler: &shaderc::Compiler, include: &Path, file: &Path, source: &str) -> Result<Kernel, Error> {
    let name = stem(file);
    let family = file.parent().map(stem).unwrap_or_default();
    let mut options = shaderc::CompileOptions::new().map_err(|e| Error::Compiler(e.to_string()))?;
    options.set_target_env(shaderc::TargetEnv::Vulkan, shaderc::EnvVersion::Vulkan1_3 as u32);
    // With 1.5 rather than 1.6, local sizes stay plain specialization constants, which every reflector understands.
    options.set_target_spirv(shaderc::SpirvVersion::V1_5);
    options.set_auto_bind_uniforms(true);
    options.set_warnings_as_errors();
    options.set_include_callback(|file, _, _, _| {
        let path = include.join(file);
        let content = std::fs::read_to_string(&path).map_err(|e| format!("{}: {e}", path.display()))?;
        Ok(shaderc::ResolvedInclude { resolved_name: path.to_string_lossy().into_owned(), content })
    });
    let artifact = compiler
        .compile_into_spirv(source, shaderc::ShaderKind::Compute, &file.to_string_lossy(), "main", Some(&options))
        .map_err(|e| Error::Glsl(name.clone(), e.to_string()))?;
    let mut kernel = reflect(name.clone(), family, artifact.as_binary()).map_err(|e| Error::Reflect(name, e))?;
    kernel.extension = required(source);
    Ok(kernel)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn required_extensions_are_detected() {
        let known = Some("GL_KHR_cooperative_matrix");
        assert_eq!(required("#version 460\n#extension GL_KHR_cooperative_matrix : require\n"), known);
        assert_eq!(required("#extension\tGL_KHR_cooperative_matrix:require"), known);
        assert_eq!(required("// #extension GL_KHR_cooperative_matrix : require"), None);
        assert_eq!(required("#extension GL_KHR_cooperative_matrix : enable"), None);
        assert_eq!(required("#extension GL_KHR_shader_subgroup_basic : require"), None);
    }

    #[test]
    fn supported_extensions_are_detected() {
        let compiler = shaderc::Compiler::new().unwrap();
        assert!(knows(&compiler, "GL_EXT_scalar_block_layout"));
        assert!(!knows(&compiler, "GL_SGS_imagined"));
    }
}
