//! `sgs report`: contents of the page, refusals, and use in a browser without a network.

use serde_json::Value;
use sgs_scene::{Image, write_png};
use sgs_tests::Place;
use sgs_tests::browser::Browser;
use sgs_tests::cli::sgs;
use sgs_tests::rooms::Room;
use std::path::Path;

/// Creates a run of all stages on a room with ground truth.
fn place() -> Place {
    let room = Room { priors: true, truth: true, ..Room::default() };
    let place = Place::new(room);
    for kind in ["priors/albedo", "priors/roughness", "gt/albedo"] {
        std::fs::create_dir_all(place.path(&format!("scene/{kind}"))).unwrap();
    }
    for camera in room.cameras() {
        let (width, height) = (camera.width, camera.height);
        let map = |kind: &str, channels: u32| {
            let data =
                room.walls(&camera).iter().flat_map(|w| vec![0.3 + 0.1 * *w as f32; channels as usize]).collect();
            let file = place.path(&format!("scene/{kind}/{}.png", camera.name));
            write_png(&file, &Image { width, height, channels, data }).unwrap();
        };
        map("priors/albedo", 3);
        map("gt/albedo", 3);
        map("priors/roughness", 1);
    }
    let mut a: Vec<String> =
        ["train", &place.text("scene"), "-o", &place.text("run"), "--stage", "all"].map(str::to_owned).to_vec();
    a.extend(["--geometry-steps", "20", "--no-densify", "--intrinsic-steps", "12"].map(str::to_owned));
    for set in [
        "transport.surfels=0",
        "intrinsic.environment.resolution=16",
        "intrinsic.lights.grid=2",
        "intrinsic.visibility.levels=4",
        "intrinsic.visibility.log2_table=10",
        "intrinsic.visibility.finest=64",
    ] {
        a.extend(["--set".to_owned(), set.to_owned()]);
    }
    sgs(&a).ok();
    place
}

/// Returns the markers of external resources in a page.
fn outside(html: &str) -> Vec<&'static str> {
    let words =
        ["://", "src=\"/", "src='", "<link rel=\"stylesheet", "@import", "url(", "<iframe", "import(", "fetch("];
    words.into_iter().filter(|w| html.contains(w)).collect()
}

#[test]
fn external_requests_are_detected() {
    assert!(outside("<img src=\"data:image/png;base64,AA//\">").is_empty());
    for bad in [
        "<script src=\"https://a/b.js\">",
        "<link rel=\"stylesheet\" href=\"a.css\">",
        "b{background:url(a.png)}",
        "<img src=\"/a.png\">",
    ] {
        assert!(!outside(bad).is_empty(), "{bad}");
    }
}

#[test]
fn run_report_is_one_page() {
    let place = place();
    let (run, page) = (place.text("run"), place.text("page.html"));
    // Metrics are missing, so the report measures and records them.
    let output = sgs(&["report", &run, "-o", &page, "--lights", "2", "--json"]).ok().json();
    assert_eq!((&output["views"], output["file"].as_str()), (&2.into(), Some(page.as_str())));
    let html = String::from_utf8(place.read("page.html")).unwrap();
    assert_eq!((output["bytes"].as_u64(), outside(&html)), (Some(html.len() as u64), vec![]));
    let metrics: Value = serde_json::from_slice(&place.read("run/metrics.json")).unwrap();
    assert_eq!(output["metrics"], metrics["test"]["mean"]);
    for section in ["images", "summary", "metrics", "views", "lights", "curves", "profile", "settings"] {
        assert!(html.contains(&format!("<section id=\"{section}\">")), "{section} is missing");
    }
    let count = |text: &str| html.matches(text).count();
    // Each of two views has sliders for color, normal, depth, shaded and albedo. Lights are the two brightest and the
    // sum of the others.
    let lights =
        html.split("<figcaption>light ").skip(1).filter(|s| s.starts_with(|c: char| c.is_ascii_digit())).count();
    assert_eq!((count("class=\"slider\""), lights, count("<figcaption>6 others ")), (10, 4, 2));
    // Images come first: photograph, render, albedo and relit side by side.
    let strip = html.split("<div class=\"grid strip\">").nth(1).and_then(|s| s.split("</div>").next()).unwrap();
    let names: Vec<&str> =
        strip.split("<figcaption>").skip(1).map(|f| f.split(['<', ' ']).next().unwrap_or_default()).collect();
    assert_eq!(names, ["photograph", "render", "albedo", "relit"]);
    assert!(html.find("grid strip") < html.find("id=\"metrics\"") && count("grid strip") == 2);
    assert!(
        html.contains("<dt>PSNR (dB)</dt>") && html.contains("<th>Normal error (°)</th>") && count("scene units") == 2
    );
    for name in ["roughness", "visibility", "environment", "direct", "diffuse", "specular"] {
        assert_eq!(count(&format!("<figcaption>{name}<")), 2, "{name}");
    }
    assert!(count("<figcaption>metallic<") == 0 && count("class=\"light\"") == 16 && count("class=\"raw\"") > 6);
    assert!(
        html.contains("geometry: a step") && html.contains("intrinsic: a step") && html.contains("[intrinsic.lights]")
    );

    in_a_browser(&place.path("page.html"));

    // Recorded metrics are shown unchanged, and foreign text is escaped.
    let mut changed = metrics.clone();
    changed["test"]["mean"]["nvs"]["psnr"] = 77.25.into();
    assert!(!html.contains("aligned"), "nothing was aligned");
    changed["test"]["mean"]["nvs"]["psnr_aligned"] = 78.5.into();
    changed["test"]["views"][0]["name"] = "<script>alert(1)</script>".into();
    let shown = &mut changed["test"]["views"][1]["nvs"];
    shown["psnr"] = 33.25.into();
    shown["psnr_aligned"] = 34.75.into();
    std::fs::write(place.path("run/metrics.json"), changed.to_string()).unwrap();
    sgs(&["report", &run, "-o", &page, "--views", "1", "--width", "16"]).ok();
    let html = String::from_utf8(place.read("page.html")).unwrap();
    assert!(html.contains("<td>77.25</td>") && !html.contains("<script>alert") && html.contains("1 more are left out"));
    // Aligned measures stand beside the others, and below the image.
    for text in [
        "<th>PSNR (dB)</th><th>PSNR, aligned (dB)</th>",
        "<td>77.25</td><td>78.50</td>",
        "<td>33.25</td><td>34.75</td>",
        "<dt>PSNR, aligned (dB)</dt><dd>78.50</dd>",
        "33.25 dB, 34.75 dB aligned",
    ] {
        assert!(html.contains(text), "{text}");
    }

    // The run has geometry alone: no lights, no environment map.
    for file in ["lights.json", "environment.exr", "visibility.safetensors"] {
        std::fs::remove_file(place.path("run").join(file)).unwrap();
    }
    sgs(&["report", &run, "-o", &page]).ok();
    let html = String::from_utf8(place.read("page.html")).unwrap();
    for (text, there) in [("id=\"lights\"", false), ("<figcaption>specular", false), ("<figcaption>albedo", true)] {
        assert_eq!(html.contains(text), there, "{text}");
    }

    let refused = |arguments: &[&str], words: &[&str]| {
        sgs(&[&["report"], arguments].concat()).refused(words);
    };
    refused(&[&place.text("scene"), "-o", &page], &["scene", "config.toml"]);
    refused(&[&run, "-o", &place.text("none/page.html")], &["none", "does not exist"]);
    refused(&[&run, "-o", &run], &["is a directory"]);
    refused(&[&run, "-o", &page, "--scene", &place.text("no")], &["no"]);
    std::fs::write(place.path("run/training.json"), "{\"st").unwrap();
    refused(&[&run, "-o", &place.text("new.html")], &["training.json", "is not valid"]);
    assert!(!place.path("new.html").exists());
}

/// Fails unless an image and a slider can be enlarged and closed. The navigation must stay in view.
fn enlarges(browser: &mut Browser) {
    let open = "document.querySelector('dialog').open";
    for (what, inside) in [("figure > img", "dialog figure > img"), (".slider ~ .enlarge", "dialog .slider input")] {
        assert_eq!(browser.eval(open), false);
        let before = browser.eval(&format!("document.querySelector('{what}').closest('figure').clientWidth"));
        browser.eval(&format!("document.querySelector('{what}').click()"));
        assert_eq!(browser.eval(&format!("{open} && document.querySelectorAll('{inside}').length === 1")), true);
        let after = browser.eval("document.querySelector('dialog figure').clientWidth");
        assert!(after.as_f64() > before.as_f64(), "{what}: {before} {after}");
        browser.eval("document.querySelector('dialog figcaption').click()");
    }
    assert_eq!(browser.eval(open), false);
    browser.eval("document.querySelector('#settings').scrollIntoView()");
    assert_eq!(browser.eval("Math.round(document.querySelector('nav').getBoundingClientRect().top)"), 0);
    browser.eval("scrollTo(0, 0)");
}

/// Fails unless the page works in narrow and wide windows. It must load completely without requests, and its sliders
/// must move.
fn in_a_browser(page: &Path) {
    let Some(mut browser) = Browser::start() else {
        eprintln!("skipped: there is no chromium, so the page was not opened");
        return;
    };
    for width in [1280, 400] {
        browser.open(page, [width, 900]);
        let whole = "[...document.images].every(i => i.complete && i.naturalWidth > 0) && document.images.length";
        assert!(browser.eval(whole).as_u64().is_some_and(|n| n > 30), "an image is missing");
        // Tables may be wider than the window, within frames of their own; the page may not.
        let [page, window] =
            ["scrollWidth", "clientWidth"].map(|w| browser.eval(&format!("document.documentElement.{w}")));
        assert!(page == window && window.as_u64().is_some_and(|w| w > 350), "{page} in {window}");
        assert_eq!(browser.complaints(), [""; 0]);
        let slider = "const s = document.querySelector('.slider');";
        let cut = "getComputedStyle(document.querySelector('.slider .over')).clipPath";
        let before = browser.eval(cut);
        enlarges(&mut browser);
        let place = browser.eval(&format!(
            "(() => {{ {slider} s.scrollIntoView({{block: 'center'}}); const q = s.getBoundingClientRect(); \
             return [q.left, q.top, q.width, q.height]; }})()"
        ));
        let [x, y, w, h] = [0, 1, 2, 3].map(|i| place[i].as_f64().unwrap());
        browser.drag([x + 0.5 * w, y + 0.5 * h], [x + 0.8 * w, y + 0.5 * h]);
        let value = browser.eval("Number(document.querySelector('.slider input').value)").as_f64().unwrap();
        assert!((value - 80.0).abs() < 2.0, "the slider stands at {value}");
        let after = browser.eval(cut);
        assert!(before != after && after.as_str().is_some_and(|t| t.contains("inset")), "{before} {after}");
        // Other sliders stay in place.
        assert_eq!(browser.eval("document.querySelectorAll('.slider input')[1].value"), "50");
        // Arrow keys move a slider as well.
        let arrow = serde_json::json!({"type": "rawKeyDown", "key": "ArrowLeft", "windowsVirtualKeyCode": 37});
        browser.ask("Input.dispatchKeyEvent", arrow);
        assert!(browser.eval("Number(document.querySelector('.slider input').value)").as_f64().unwrap() < value);
        let retained = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("report-{width}.png"));
        browser.photograph(true, &retained);
        eprintln!("the page, {width} wide, is in {}", retained.display());
    }
    let dark = serde_json::json!({"features": [{"name": "prefers-color-scheme", "value": "dark"}]});
    let back = "getComputedStyle(document.body).backgroundColor";
    let light = browser.eval(back);
    browser.ask("Emulation.setEmulatedMedia", dark);
    assert_ne!(browser.eval(back), light);
}
