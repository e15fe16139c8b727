//! Gate: compares compiled kernels with stored ones.

use super::report::{Family, Report, Row};
use super::worker::Gpu;

/// Growth of vector registers that counts as none.
const TOLERANCE: f64 = 0.1;

/// Outcome of a comparison.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Outcome {
    /// Number of compared kernels.
    pub compared: usize,
    /// Sentences about kernels that became worse.
    pub worse: Vec<String>,
}

/// Compares a report with a stored one.
///
/// A kernel whose specialization is not stored is compared with the worst stored one of the same kernel.
///
/// # Errors
/// If no report of the same family and driver is stored.
pub fn check(stored: &Report, found: &Report) -> anyhow::Result<Outcome> {
    let mut outcome = Outcome::default();
    for family in &found.families {
        let before = stored_like(stored, &family.family, &family.gpu)?;
        for row in &family.rows {
            outcome.compared += 1;
            outcome.worse.extend(worse(before, row));
        }
    }
    Ok(outcome)
}

/// Returns the stored family of the same name and driver.
///
/// # Errors
/// If there is none.
pub fn stored_like<'s>(stored: &'s Report, family: &str, gpu: &Gpu) -> anyhow::Result<&'s Family> {
    let same: Vec<&Family> = stored.families.iter().filter(|f| f.family == family).collect();
    let Some(first) = same.first() else {
        anyhow::bail!("No report of {family} is stored; record one with -o.");
    };
    same.iter().find(|f| f.gpu.driver == gpu.driver).copied().ok_or_else(|| {
        let (before, now) = (&first.gpu.driver, &gpu.driver);
        anyhow::anyhow!(
            "The stored report of {family} is by {before}, but this driver is {now}; record it again with -o."
        )
    })
}

/// Says how a kernel became worse than stored.
fn worse(before: &Family, row: &Row) -> Option<String> {
    let alike: Vec<&Row> = before.rows.iter().filter(|b| (&b.kernel, b.lanes) == (&row.kernel, row.lanes)).collect();
    let exact: Vec<&Row> = alike.iter().filter(|b| b.specs == row.specs).copied().collect();
    let with = if exact.is_empty() { alike } else { exact };
    if let Some(problem) = &row.problem {
        let known = with.iter().any(|b| b.problem.is_some());
        return (!known).then(|| format!("{} no longer compiles: {problem}.", row.title()));
    }
    // A kernel that did not compile has no numbers to compare with.
    let with: Vec<&Row> = with.into_iter().filter(|b| b.problem.is_none()).collect();
    let most = |number: fn(&Row) -> f64| with.iter().map(|b| number(b)).fold(0.0, f64::max);
    let [vector, scalar, scratch] = row.spills();
    for (number, most, what) in [
        (vector, most(|b| b.spills()[0]), "vector registers"),
        (scalar, most(|b| b.spills()[1]), "scalar registers"),
        (scratch, most(|b| b.spills()[2]), "bytes of scratch memory"),
    ] {
        if number > most {
            return Some(format!("{} spills {number} {what} (stored: {most}).", row.title()));
        }
    }
    let (registers, most) = (row.registers(), most(Row::registers));
    (!with.is_empty() && registers > (1.0 + TOLERANCE) * most)
        .then(|| format!("{} uses {registers} vector registers (stored: {most}).", row.title()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(kernel: &str, spec: u32, registers: f64, spilled: f64) -> Row {
        let statistics = [("VGPRs", registers), ("Spilled VGPRs", spilled)].map(|(name, n)| (name.to_owned(), n));
        Row {
            family: "navi21".into(),
            lanes: 32,
            kernel: kernel.into(),
            specs: [("SPEC".to_owned(), spec)].into(),
            statistics: statistics.into(),
            problem: None,
        }
    }

    fn report(driver: &str, rows: Vec<Row>) -> Report {
        let gpu = Gpu {
            name: "GPU".into(),
            driver: driver.into(),
            subgroup_sizes: (32, 64),
            max_shared_bytes: 65536,
            float_atomics: true,
            matrices: vec![],
        };
        Report { families: vec![Family { family: "navi21".into(), gpu, rows }] }
    }

    #[test]
    fn new_spills_and_more_registers_fail() {
        let stored = report("a", vec![row("blend", 1, 100.0, 0.0), row("blend", 2, 50.0, 3.0)]);
        let worse = |rows: Vec<Row>| check(&stored, &report("a", rows)).unwrap().worse;
        assert_eq!(worse(vec![row("blend", 1, 110.0, 0.0), row("blend", 2, 40.0, 3.0)]), [""; 0]);
        let title = |spec| format!("blend on navi21 at 32 lanes (SPEC={spec})");
        assert_eq!(
            worse(vec![row("blend", 1, 111.0, 0.0), row("blend", 2, 50.0, 4.0)]),
            [
                format!("{} uses 111 vector registers (stored: 100).", title(1)),
                format!("{} spills 4 vector registers (stored: 3).", title(2)),
            ]
        );
        // Another specialization is compared with the worst of the kernel, and a new kernel must not spill.
        assert_eq!(worse(vec![row("blend", 3, 110.0, 3.0), row("new", 1, 250.0, 0.0)]), [""; 0]);
        assert_eq!(worse(vec![row("blend", 3, 111.0, 0.0), row("new", 1, 9.0, 1.0)]).len(), 2);
    }

    #[test]
    fn kernels_that_stop_compiling_fail() {
        let mut broken = row("blend", 1, 0.0, 0.0);
        broken.problem = Some("the compiler crashed (signal 11)".into());
        let (fine, broken) = (report("a", vec![row("blend", 1, 9.0, 0.0)]), report("a", vec![broken]));
        let sentence = "blend on navi21 at 32 lanes (SPEC=1) no longer compiles: the compiler crashed (signal 11).";
        assert_eq!(check(&fine, &broken).unwrap().worse, [sentence]);
        assert_eq!(check(&broken, &broken).unwrap().worse, [""; 0]);
        assert_eq!(check(&broken, &fine).unwrap().worse, [""; 0]);
    }

    #[test]
    fn reports_of_another_driver_are_refused() {
        let rows = || vec![row("blend", 1, 9.0, 0.0)];
        let error = check(&report("a", rows()), &report("b", rows())).unwrap_err().to_string();
        assert_eq!(error, "The stored report of navi21 is by a, but this driver is b; record it again with -o.");
        let error = check(&Report::default(), &report("b", rows())).unwrap_err().to_string();
        assert_eq!(error, "No report of navi21 is stored; record one with -o.");
    }

    #[test]
    fn table_begins_with_crashes_and_spills() {
        let mut broken = row("crash", 1, 0.0, 0.0);
        (broken.problem, broken.statistics) = (Some("the compiler crashed".into()), Default::default());
        let rows = vec![row("a", 1, 10.0, 0.0), row("b", 0x3f00_0000, 200.0, 0.0), row("c", 1, 20.0, 7.0), broken];
        let report = report("a", rows);
        let kernels: Vec<&str> = report.sorted().iter().map(|r| r.kernel.as_str()).collect();
        assert_eq!(kernels, ["crash", "c", "b", "a"]);
        let table = report.table();
        assert!(table.contains("| navi21 | 32 | b | SPEC=0.5 | 200 |  | 0 |"), "{table}");
        assert!(table.contains("| navi21 | 32 | crash | SPEC=1 | the compiler crashed |"), "{table}");
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("a.json"), report.json().unwrap()).unwrap();
        assert_eq!(Report::read(folder.path()).unwrap(), report);
        assert_eq!(Report::read(&folder.path().join("a.json")).unwrap(), report);
    }
}
