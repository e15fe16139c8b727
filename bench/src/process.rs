//! CPU time of the process.

/// Returns user and system seconds of all threads since the start.
///
/// `None` where the system does not report them in `/proc` (Linux).
pub fn cpu_seconds() -> Option<f64> {
    parse(&std::fs::read_to_string("/proc/self/stat").ok()?)
}

/// Ticks per second in `/proc`: 100 on every architecture in use.
const TICKS: f64 = 100.0;

fn parse(stat: &str) -> Option<f64> {
    // The command name may contain spaces and parentheses; the remaining fields do not.
    let (_, rest) = stat.rsplit_once(')')?;
    let mut fields = rest.split_whitespace().skip(11);
    let user: f64 = fields.next()?.parse().ok()?;
    let system: f64 = fields.next()?.parse().ok()?;
    Some((user + system) / TICKS)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_are_found_behind_a_name_with_parentheses() {
        let stat = "12 (a) b (c) R 1 12 12 0 -1 4194304 100 0 0 0 250 50 0 0 20 0 1 0 500 1000";
        assert_eq!(parse(stat), Some(3.0));
        assert_eq!(parse("nothing"), None);
    }

    #[test]
    fn cpu_time_increases_with_work() {
        if let Some(begin) = cpu_seconds() {
            let until = std::time::Instant::now();
            while until.elapsed().as_millis() < 60 {
                std::hint::black_box(0);
            }
            assert!(cpu_seconds().is_some_and(|end| end > begin));
        }
    }
}
