//! Job array of Slurm that trains the runs of a batch.

use crate::batch::Batch;

/// Largest number of tasks of an array. Slurm's `MaxArraySize` is 1001 unless the cluster sets it, and indices start at 0.
const MOST_TASKS: usize = 1000;

/// Script for `sbatch`, with a task per run. Tasks share the runs if the runs are many.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ArrayScript {
    /// Text of the script.
    pub text: String,
    /// Number of tasks.
    pub tasks: usize,
}

impl ArrayScript {
    /// Writes the script of a batch.
    ///
    /// `command`: words that start `sgs batch`, to which each task adds `--only` with the names of its runs.
    pub fn new(batch: &Batch, command: &[String]) -> ArrayScript {
        let count = batch.runs.len();
        let tasks = count.min(MOST_TASKS);
        let runs = batch.order(None).into_iter().map(|i| format!("    {}\n", quote(&batch.runs[i].name())));
        let words: Vec<String> = command.iter().map(|word| quote(word)).collect();
        let text = include_str!("slurm.sh")
            .replace("@COUNT@", &count.to_string())
            .replace("@LAST@", &tasks.saturating_sub(1).to_string())
            .replace("@TASKS@", &tasks.to_string())
            // Last, so that no path or name is taken for a place in the script.
            .split_once("@COMMAND@")
            .and_then(|(start, rest)| Some((start, rest.split_once("@RUNS@")?)))
            .map(|(start, (middle, end))| [start, &words.join(" "), middle, &runs.collect::<String>(), end].concat())
            .unwrap_or_default();
        ArrayScript { text, tasks }
    }
}

/// Quotes a word for a shell, if it needs quotes.
pub fn quote(word: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./=:,+".contains(c);
    if !word.is_empty() && word.chars().all(plain) {
        word.to_owned()
    } else {
        format!("'{}'", word.replace('\'', "'\\''"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::batch::Run;
    use crate::batch::tests::{batch, run};
    use std::process::Command;

    /// Runs the script of an array's task, with `echo` in the place of sgs. Returns what it prints.
    fn task(script: &ArrayScript, index: usize) -> String {
        let mut bash = Command::new("bash");
        bash.args(["-c", &script.text]).env("SLURM_ARRAY_TASK_ID", index.to_string());
        let output = bash.output().unwrap();
        assert!(output.status.success() && output.stderr.is_empty(), "{output:?}");
        String::from_utf8(output.stdout).unwrap()
    }

    #[test]
    fn each_task_trains_its_run_most_expensive_first() {
        let names = ["it's", "a b", "@RUNS@"];
        let runs = names.iter().enumerate().map(|(i, name)| Run { cost: i as u128, ..run(name, 0) });
        let command = ["echo", "batch", "my rooms.toml", "-o", "@RUNS@/$HOME"].map(String::from);
        let script = ArrayScript::new(&batch(runs.collect()), &command);
        assert_eq!(script.tasks, 3);
        assert!(script.text.contains("\n#SBATCH --array=0-2\n"), "{}", script.text);
        for (index, name) in ["@RUNS@", "a b", "it's"].iter().enumerate() {
            let expected = format!("batch my rooms.toml -o @RUNS@/$HOME --only {name}/fast/seed0\n");
            assert_eq!(task(&script, index), expected);
        }
    }

    #[test]
    fn tasks_share_many_runs_without_gaps() {
        let all = batch((0..2500).map(|seed| run("a", seed)).collect());
        let script = ArrayScript::new(&all, &["echo".into()]);
        assert_eq!(script.tasks, 1000);
        assert_eq!(task(&script, 499), "--only a/fast/seed499 --only a/fast/seed1499 --only a/fast/seed2499\n");
        assert_eq!(task(&script, 999), "--only a/fast/seed999 --only a/fast/seed1999\n");
    }

    #[test]
    fn words_are_quoted_as_a_shell_reads_them() {
        for (word, quoted) in [("a/b.c", "a/b.c"), ("", "''"), ("a b", "'a b'"), ("it's", "'it'\\''s'")] {
            assert_eq!(quote(word), quoted);
        }
    }
}
