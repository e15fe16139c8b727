//! Virtual display (Xvfb) with mouse and keyboard input (XTEST, through xdotool).
//!
//! Tests use windows in it as a person would and read the image on the screen.

use sgs_scene::Image;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// Time limit for a window. Machines that run tests are busy.
const PATIENCE: Duration = Duration::from_secs(400);

/// Virtual display.
pub struct Screen {
    server: Child,
    name: String,
    folder: TempDir,
}

impl Screen {
    /// Starts a display of this size, in pixels.
    ///
    /// Returns `None` and prints the reason if Xvfb or xdotool is not installed.
    pub fn start([width, height]: [u32; 2]) -> Option<Screen> {
        let there = |name: &str| Command::new(name).arg("-help").stderr(Stdio::null()).stdout(Stdio::null()).status();
        for name in ["Xvfb", "xdotool"] {
            if there(name).is_err() {
                eprintln!("skipped: there is no {name}, so no window was opened");
                return None;
            }
        }
        let folder = tempfile::tempdir().expect("a folder");
        let mut command = Command::new("Xvfb");
        command.args(["-displayfd", "1", "-nolisten", "tcp", "-noreset", "-screen", "0"]);
        command.arg(format!("{width}x{height}x24")).arg("-fbdir").arg(folder.path());
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::null());
        let mut server = command.spawn().expect("Xvfb starts");
        let mut number = String::new();
        BufReader::new(server.stdout.take().expect("a pipe")).read_line(&mut number).expect("a number");
        assert!(!number.trim().is_empty(), "Xvfb gave no display");
        Some(Screen { server, name: format!(":{}", number.trim()), folder })
    }

    /// Returns its name, for `DISPLAY`.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Runs an xdotool command for mouse, keyboard or windows, and returns its output.
    #[track_caller]
    pub fn act<S: AsRef<str>>(&self, arguments: &[S]) -> String {
        let arguments: Vec<&str> = arguments.iter().map(AsRef::as_ref).collect();
        let output =
            Command::new("xdotool").args(&arguments).env("DISPLAY", &self.name).output().expect("xdotool runs");
        assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8_lossy(&output.stdout).trim().to_owned()
    }

    /// Waits for a window whose title contains a text, focuses it and returns its id.
    #[track_caller]
    pub fn window(&self, title: &str) -> String {
        let mut found = String::new();
        self.until("a window", || {
            let search = Command::new("xdotool")
                .args(["search", "--onlyvisible", "--name", title])
                .env("DISPLAY", &self.name)
                .output()
                .expect("xdotool runs");
            found = String::from_utf8_lossy(&search.stdout).lines().next().unwrap_or_default().to_owned();
            !found.is_empty()
        });
        // The display has no window manager, which would otherwise set the focus.
        self.act(&["windowfocus", "--sync", &found]);
        found
    }

    /// Presses a button at a point of the screen, moves to another and releases.
    ///
    /// The pointer moves in four steps.
    #[track_caller]
    pub fn drag(&self, button: &str, from: [f64; 2], to: [f64; 2]) {
        self.point(from);
        self.act(&["mousedown", button]);
        for k in 1..=4 {
            let share = f64::from(k) / 4.0;
            self.point([0, 1].map(|i| from[i] + share * (to[i] - from[i])));
        }
        self.act(&["mouseup", button]);
    }

    /// Moves the pointer.
    #[track_caller]
    pub fn point(&self, at: [f64; 2]) {
        let [x, y] = at.map(|v| (v.round() as i64).to_string());
        self.act(&["mousemove", &x, &y]);
    }

    /// Waits until a file exists, and returns its path.
    #[track_caller]
    pub fn file(&self, path: &Path) -> PathBuf {
        self.until(&path.display().to_string(), || path.is_file());
        path.to_owned()
    }

    /// Waits until a condition holds.
    #[track_caller]
    pub fn until(&self, what: &str, mut holds: impl FnMut() -> bool) {
        let begun = Instant::now();
        while !holds() {
            assert!(begun.elapsed() < PATIENCE, "{what} is not there after {PATIENCE:?}");
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Returns the image on the screen, from its upper left corner.
    #[track_caller]
    pub fn image(&self) -> Image {
        let bytes = std::fs::read(self.folder.path().join("Xvfb_screen0")).expect("the screen's memory");
        // X window dump: 25 numbers, a name, colors of 12 bytes each, rows of BGRX.
        let number = |i: usize| u32::from_be_bytes([0, 1, 2, 3].map(|k| bytes[4 * i + k])) as usize;
        let (width, height, row) = (number(4), number(5), number(12));
        let first = number(0) + 12 * number(19);
        assert_eq!((number(1), number(11)), (7, 32), "another dump was expected");
        let texel = |x: usize, y: usize| {
            let at = first + y * row + 4 * x;
            [2, 1, 0].map(|c| f32::from(bytes[at + c]) / 255.0)
        };
        let data = (0..height).flat_map(|y| (0..width).flat_map(move |x| texel(x, y))).collect();
        Image { width: width as u32, height: height as u32, channels: 3, data }
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        let _gone = self.server.kill().and_then(|()| self.server.wait());
    }
}
