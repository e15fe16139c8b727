//! Chromium without a window or network, driven through two pipes.
//!
//! The pipes carry the DevTools protocol.
//!
//! Tests open, evaluate, drag and capture pages as a person would.

use base64::prelude::{BASE64_STANDARD, Engine as _};
use serde_json::{Value, json};
use std::fs::File;
use std::io::{BufRead, BufReader, Write};
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// Time limit for a reply. Machines that run tests are busy.
const PATIENCE: Duration = Duration::from_secs(120);

/// Browser with one page.
pub struct Browser {
    child: Child,
    to: File,
    from: Receiver<Value>,
    next: u64,
    session: String,
    /// Events that the browser sent.
    reported: Vec<Value>,
    /// Directory of its profile and pipes, deleted on drop.
    _folder: TempDir,
}

impl Browser {
    /// Starts Chromium. Returns `None` if it is not installed.
    pub fn start() -> Option<Browser> {
        Browser::start_with(&["--disable-gpu"])
    }

    /// Starts Chromium with WebGL, drawn by the processor. Returns `None` if it is not installed.
    pub fn start_drawing() -> Option<Browser> {
        Browser::start_with(&["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"])
    }

    fn start_with(options: &[&str]) -> Option<Browser> {
        let known = ["chromium", "chromium-browser"];
        let name =
            known.iter().find(|n| Command::new(n).arg("--version").output().is_ok_and(|o| o.status.success()))?;
        let folder = tempfile::tempdir().expect("a folder");
        let pipes = ["in", "out"].map(|n| folder.path().join(n));
        let made = Command::new("mkfifo").args(&pipes).status();
        assert!(made.is_ok_and(|s| s.success()), "mkfifo failed");
        // The browser reads from file descriptor 3 and writes to 4. Its resolver finds no host but 127.0.0.1.
        let mut command = Command::new("bash");
        command.args(["-c", "exec 3<\"$1\" 4>\"$2\"; shift 2; exec \"$@\"", "bash"]).args(&pipes).arg(name);
        command.args(["--headless=new", "--no-sandbox", "--remote-debugging-pipe", "--no-first-run", "--disable-quic"]);
        command.args(["--disable-background-networking", "--disable-component-update", "--disable-sync"]);
        command.args(options);
        command.args(["--disable-dev-shm-usage", "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1"]);
        command.arg(format!("--user-data-dir={}", folder.path().join("profile").display()));
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).process_group(0);
        let child = command.spawn().expect("chromium starts");
        let to = File::options().write(true).open(&pipes[0]).expect("a pipe");
        let answers = BufReader::new(File::open(&pipes[1]).expect("a pipe"));
        let (send, from) = channel();
        std::thread::spawn(move || {
            for message in answers.split(0).map_while(Result::ok) {
                let Ok(message) = serde_json::from_slice(&message) else { continue };
                if send.send(message).is_err() {
                    break;
                }
            }
        });
        let session = String::new();
        let mut browser = Browser { child, to, from, next: 0, session, reported: Vec::new(), _folder: folder };
        let target = browser.ask("Target.createTarget", json!({"url": "about:blank"}))["targetId"].clone();
        let attached = browser.ask("Target.attachToTarget", json!({"targetId": target, "flatten": true}));
        browser.session = attached["sessionId"].as_str().expect("a session").to_owned();
        for domain in ["Page.enable", "Runtime.enable", "Network.enable", "Log.enable"] {
            browser.ask(domain, json!({}));
        }
        Some(browser)
    }

    /// Sends a command and waits for its reply.
    #[track_caller]
    pub fn ask(&mut self, method: &str, params: Value) -> Value {
        self.next += 1;
        let mut message = json!({"id": self.next, "method": method, "params": params});
        if !self.session.is_empty() {
            message["sessionId"] = self.session.clone().into();
        }
        let mut bytes = message.to_string().into_bytes();
        bytes.push(0);
        self.to.write_all(&bytes).expect("the browser listens");
        loop {
            let answer = self.from.recv_timeout(PATIENCE).unwrap_or_else(|e| panic!("{method}: no answer ({e})"));
            if answer["id"] == self.next {
                assert!(answer["error"].is_null(), "{method}: {answer}");
                return answer["result"].clone();
            }
            self.reported.push(answer);
        }
    }

    /// Opens a local file in a window of this size, and waits for the page.
    #[track_caller]
    pub fn open(&mut self, page: &Path, size: [u32; 2]) {
        self.visit(&format!("file://{}", page.display()), size);
    }

    /// Opens an address on this machine, and waits until the page is complete.
    #[track_caller]
    pub fn visit(&mut self, address: &str, [width, height]: [u32; 2]) {
        self.reported.clear();
        let size = json!({"width": width, "height": height, "deviceScaleFactor": 1, "mobile": false});
        self.ask("Emulation.setDeviceMetricsOverride", size);
        let answer = self.ask("Page.navigate", json!({"url": address}));
        assert!(answer["errorText"].is_null(), "{answer}");
        let begun = Instant::now();
        let protocol = address.split_inclusive(':').next().unwrap_or_default();
        while self.eval("document.readyState") != "complete" || self.eval("location.protocol") != protocol {
            assert!(begun.elapsed() < PATIENCE, "the page is never complete");
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    /// Evaluates an expression in the page.
    #[track_caller]
    pub fn eval(&mut self, expression: &str) -> Value {
        let params = json!({"expression": expression, "returnByValue": true, "awaitPromise": true});
        let answer = self.ask("Runtime.evaluate", params);
        assert!(answer["exceptionDetails"].is_null(), "{expression}: {answer}");
        answer["result"]["value"].clone()
    }

    /// Presses the mouse at a point of the window, moves to another point and releases.
    pub fn drag(&mut self, from: [f64; 2], to: [f64; 2]) {
        for (kind, [x, y]) in [("mousePressed", from), ("mouseMoved", to), ("mouseReleased", to)] {
            let event = json!({"type": kind, "x": x, "y": y, "button": "left", "buttons": 1, "clickCount": 1});
            self.ask("Input.dispatchMouseEvent", event);
        }
    }

    /// Writes a PNG file of the window, or of the whole page.
    pub fn photograph(&mut self, whole: bool, path: &Path) {
        let size = self.ask("Page.getLayoutMetrics", json!({}))["cssContentSize"].clone();
        let mut params = json!({"format": "png", "captureBeyondViewport": whole});
        if whole {
            params["clip"] = json!({"x": 0, "y": 0, "width": size["width"], "height": size["height"], "scale": 1});
        }
        let answer = self.ask("Page.captureScreenshot", params);
        let image = BASE64_STANDARD.decode(answer["data"].as_str().unwrap_or_default()).expect("the answer is base64");
        std::fs::write(path, image).expect("the image is written");
    }

    /// Returns the page's external requests and its errors.
    ///
    /// The document and `data:` URLs do not count as external.
    pub fn complaints(&mut self) -> Vec<String> {
        self.eval("1");
        let report_text = |e: &Value| match e["method"].as_str().unwrap_or_default() {
            "Network.requestWillBeSent" => {
                let url = e["params"]["request"]["url"].as_str().unwrap_or_default();
                (!url.starts_with("data:") && e["params"]["type"] != "Document").then(|| format!("asks for {url}"))
            }
            "Runtime.exceptionThrown" | "Log.entryAdded" => Some(e["params"].to_string()),
            _ => None,
        };
        self.reported.iter().filter_map(report_text).collect()
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        // `Browser.close` also ends the child processes of the browser.
        let _ = self.to.write_all(b"{\"id\":0,\"method\":\"Browser.close\"}\0");
        let begun = Instant::now();
        while begun.elapsed() < Duration::from_secs(10) && self.child.try_wait().is_ok_and(|s| s.is_none()) {
            std::thread::sleep(Duration::from_millis(20));
        }
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Tests that errors, requests and missing files are reported; tests of pages rely on this.
    #[test]
    fn page_errors_and_requests_are_reported() {
        let Some(mut browser) = Browser::start() else {
            eprintln!("skipped: there is no chromium");
            return;
        };
        let folder = tempfile::tempdir().expect("a folder");
        let page = folder.path().join("a.html");
        let mut open = |html: &str| {
            std::fs::write(&page, html).expect("a page");
            browser.open(&page, [300, 200]);
            browser.complaints()
        };
        let icon = "<link rel=icon href=data:,>";
        assert_eq!(open(&format!("{icon}<p>good</p>")), [""; 0]);
        assert!(open(&format!("{icon}<script>throw 1</script>")).iter().any(|c| c.contains("exception")));
        assert!(open(&format!("{icon}<img src=\"http://x.invalid/a.png\">")).iter().any(|c| c.contains("x.invalid")));
        assert!(open(&format!("{icon}<img src=\"b.png\">")).iter().any(|c| c.contains("b.png")));
    }
}
