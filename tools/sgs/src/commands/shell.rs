//! Shell completions and manual pages: `sgs completions` and `sgs man`.
//!
//! Both are generated from the clap definitions, so that they always agree with the command line.

use crate::common::Common;
use anyhow::Context;
use clap::Command;
use clap_complete::Shell;
use clap_mangen::Man;
use std::io::Write;
use std::path::PathBuf;

#[derive(clap::Args)]
pub struct Completions {
    /// Shell that reads the script.
    #[arg(value_enum)]
    shell: Shell,
}

#[derive(clap::Args)]
pub struct Pages {
    /// Directory for the pages; created if missing.
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
}

/// Prints the completion script.
pub fn completions(a: &Completions, mut command: Command) -> anyhow::Result<()> {
    let mut script = Vec::new();
    clap_complete::generate(a.shell, &mut command, "sgs", &mut script);
    std::io::stdout().write_all(&script).context("while printing")
}

/// Writes a manual page for the program and for every command.
pub fn man(common: &Common, a: &Pages, command: Command) -> anyhow::Result<()> {
    crate::output::make(&a.output)?;
    // `build` copies the global options into all commands.
    let mut command = command.disable_help_subcommand(true);
    command.build();
    let subs: Vec<Command> = command.get_subcommands().cloned().collect();
    let mut files = Vec::new();
    for page in [command].into_iter().chain(subs) {
        let page = Man::new(page);
        let mut text = Vec::new();
        page.render(&mut text).context("while making a page")?;
        let file = a.output.join(page.get_filename());
        sgs_scene::atomic_write(&file, |f| f.write_all(&text))?;
        files.push(file);
    }
    if !common.answer(&serde_json::json!({"files": files}))? && !common.quiet {
        eprintln!("wrote {} pages to {}", files.len(), a.output.display());
    }
    Ok(())
}
