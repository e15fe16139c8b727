//! `sgs train --watch`: the page follows the training in a browser. Watching does not change the training, and no port
//! is open without the option.

use sgs_tests::Place;
use sgs_tests::browser::Browser;
use sgs_tests::cli::{sgs, signal, start, until, wait};
use sgs_tests::rooms::Room;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::process::Child;
use std::time::{Duration, Instant};

/// Returns the arguments of a training of both stages.
fn arguments(place: &Place, run: &str, steps: [u32; 2]) -> Vec<String> {
    let mut a = place.arguments(run, steps[0], &["--stage", "all"]);
    a.extend(["--intrinsic-steps".into(), steps[1].to_string()]);
    for set in [
        "transport.surfels=0",
        "intrinsic.environment.resolution=16",
        "intrinsic.lights.grid=2",
        "intrinsic.visibility.levels=4",
        "intrinsic.visibility.log2_table=10",
        "intrinsic.visibility.finest=64",
    ] {
        a.extend(["--set".into(), set.into()]);
    }
    a
}

/// Returns the addresses that a process listens on, in the system's notation.
fn listening(child: &Child) -> Vec<String> {
    let mut sockets = Vec::new();
    for file in std::fs::read_dir(format!("/proc/{}/fd", child.id())).into_iter().flatten().flatten() {
        let target = std::fs::read_link(file.path()).unwrap_or_default();
        sockets.extend(target.to_str().and_then(|t| t.strip_prefix("socket:[")?.strip_suffix(']')).map(str::to_owned));
    }
    let mut all = Vec::new();
    for table in ["tcp", "tcp6"] {
        let text = std::fs::read_to_string(format!("/proc/net/{table}")).unwrap_or_default();
        for line in text.lines().skip(1) {
            let words: Vec<&str> = line.split_whitespace().collect();
            if words[3] == "0A" && sockets.iter().any(|s| s == words[9]) {
                all.push(words[1].to_owned());
            }
        }
    }
    all
}

/// Returns the page's address as the training prints it.
fn address(child: &mut Child) -> String {
    let mut output = BufReader::new(child.stderr.take().expect("a pipe"));
    let mut line = String::new();
    while !line.contains("http://") {
        line.clear();
        assert!(output.read_line(&mut line).expect("text") > 0, "it never says where the page is");
    }
    // Further output must not fill the pipe.
    std::thread::spawn(move || output.lines().for_each(drop));
    line.split_whitespace().find(|w| w.starts_with("http://")).expect("an address").to_owned()
}

/// Evaluates an expression in the page until it is true.
#[track_caller]
fn until_page(browser: &mut Browser, expression: &str) {
    let begun = Instant::now();
    while browser.eval(expression) != true {
        assert!(begun.elapsed() < Duration::from_secs(120), "never: {expression}");
        std::thread::sleep(Duration::from_millis(100));
    }
}

/// Returns the answer at a port to a request with a given host.
fn answer(port: u16, host: &str) -> String {
    let mut stream = TcpStream::connect(("127.0.0.1", port)).expect("it listens");
    write!(stream, "GET / HTTP/1.1\r\nHost: {host}\r\n\r\n").expect("it reads");
    let mut text = String::new();
    stream.read_to_string(&mut text).expect("an answer");
    text
}

#[test]
fn page_follows_the_training() {
    let place = Place::new(Room { priors: true, ..Room::default() });
    let mut a = arguments(&place, "run", [1_000_000, 10]);
    let mut plain = start(&a);
    assert!(until(&mut plain, || !place.logged("run").is_empty()), "it does not train");
    assert!(cfg!(not(target_os = "linux")) || listening(&plain).is_empty(), "something is open that nobody asked for");
    signal(&plain, "INT");
    wait(plain);

    a[3] = place.text("watched");
    a.extend(["--watch".into(), "0".into()]);
    let mut child = start(&a);
    let page = address(&mut child);
    let port = page.trim_end_matches('/').rsplit(':').next().expect("a port").to_owned();
    let number: u16 = port.parse().expect("a number");
    if cfg!(target_os = "linux") {
        // The address is 127.0.0.1, lowest byte first.
        assert_eq!(listening(&child), [format!("0100007F:{number:04X}")]);
    }
    // A port in use is reported before anything is created.
    let mut second = arguments(&place, "second", [10, 10]);
    second.extend(["--watch".into(), port]);
    sgs(&second).refused(&["in use", "--watch=PORT"]);
    assert!(!place.path("second").exists());

    let Some(mut browser) = Browser::start() else {
        eprintln!("skipped: there is no chromium, so the page was not opened");
        signal(&child, "INT");
        wait(child);
        return;
    };
    browser.visit(&page, [1100, 900]);
    until_page(&mut browser, "document.querySelectorAll('#curves svg').length > 1");
    until_page(&mut browser, "document.querySelectorAll('#views .slider').length === 2");
    let whole = "[...document.images].every(i => i.complete && i.naturalWidth > 0)";
    until_page(&mut browser, whole);
    // Curves grow, images change, and a moved slider stays in place.
    let [last, visible] = [
        "[...document.querySelectorAll('#curves svg')][0].lastElementChild.textContent",
        "document.querySelector('#views p').textContent",
    ];
    let [before, images] = [last, visible].map(|e| browser.eval(e));
    assert!(images.as_str().is_some_and(|p| p.contains("of geometry") && p.contains("% of the time")), "{images}");
    browser.eval("{ const s = document.querySelector('.slider input'); s.value = 80; place(s); 1 }");
    until_page(&mut browser, &format!("{last} !== {before}"));
    until_page(&mut browser, &format!("{visible} !== {images}"));
    assert_eq!(browser.eval("document.querySelector('.slider input').value"), "80");
    let ours = format!("asks for {page}live?");
    let complaints: Vec<String> = browser.complaints().into_iter().filter(|c| !c.starts_with(&ours)).collect();
    assert_eq!(complaints, [""; 0]);
    let retained = Path::new(env!("CARGO_TARGET_TMPDIR")).join("watch.png");
    browser.photograph(true, &retained);
    eprintln!("the page is in {}", retained.display());

    let curve =
        "[...document.querySelectorAll('#curves figcaption')].some(c => c.textContent.startsWith('PSNR of held'))";
    until_page(&mut browser, curve);
    // A page at a forwarded port sends that port in its host header.
    assert!(answer(number, &format!("localhost:{}", number ^ 1)).contains("200 OK"));
    assert!(answer(number, "elsewhere.example").contains("403"));

    signal(&child, "INT");
    let ended = wait(child);
    assert_eq!(ended.status, Some(130), "{}", ended.stderr);
    ended.assert_no_panic();
    assert!(TcpListener::bind(("127.0.0.1", number)).is_ok(), "the port is still open");
    until_page(&mut browser, "document.body.classList.contains('finished')");
    until_page(&mut browser, "document.querySelector('#summary').textContent.includes('stopped after step')");
    let requested = browser.complaints().len();
    std::thread::sleep(Duration::from_millis(4500));
    assert_eq!(browser.complaints().len(), requested, "the page goes on asking");
    assert!(browser.eval("document.querySelectorAll('#curves svg').length > 1") == true, "it does not stay");
}

#[test]
fn watching_does_not_change_training() {
    let place = Place::new(Room { priors: true, ..Room::default() });
    sgs(&arguments(&place, "plain", [40, 12])).ok();
    let mut a = arguments(&place, "watched", [40, 12]);
    a.push("--watch=0".into());
    let output = sgs(&a).ok();
    assert!(output.stderr.contains("watch it at http://127.0.0.1:"), "{}", output.stderr);
    assert!(!output.stderr.contains("no more images"), "{}", output.stderr);
    place.assert_same("plain", "watched");
    for file in ["lights.json", "environment.exr", "visibility.safetensors"] {
        assert!(place.read(&format!("plain/{file}")) == place.read(&format!("watched/{file}")), "{file}");
    }
    assert_eq!(sgs(&["train", "a", "-o", "b", "--watch=70000"]).status, Some(2));
}
