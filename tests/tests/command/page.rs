//! `sgs export --web`: the page shows a run as the renderer does, in a browser without a network, from files.

use serde_json::{Value, json};
use sgs_scene::{Camera, Splats};
use sgs_tests::browser::Browser;
use sgs_tests::cli::sgs;
use sgs_tests::emitting::{EMITTERS, fabricate_emitting};
use sgs_tests::rooms::{transforms, write_json};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Least PSNR in dB between the page and `sgs render` of the colors of a run. docs/guide/page.md states it.
const COLORS: f64 = 50.0;

/// Least PSNR in dB between the page and `sgs relight`.
const LIGHTS: f64 = 44.0;

/// Run with emitters and harmonics of degree 2, and its page.
struct Exported {
    folder: tempfile::TempDir,
    cameras: Vec<Camera>,
    answer: Value,
}

impl Exported {
    fn new() -> Exported {
        let folder = tempfile::tempdir().unwrap();
        fabricate_emitting(folder.path());
        let path = |name: &str| folder.path().join(name);
        let mut splats = Splats::read_ply(&path("run/scene.ply")).unwrap();
        for band in 0..3_usize {
            let width = 3 * (2 * band + 1);
            let value = |i: usize| (0.9 - 0.3 * band as f32) * (i as f32 * (0.61 + 0.2 * band as f32)).sin();
            splats.sh[band] = (0..width * splats.len()).map(value).collect();
        }
        splats.opacity_logits.iter_mut().enumerate().for_each(|(i, v)| *v -= (i % 5) as f32);
        splats.write_ply(&path("run/scene.ply")).unwrap();
        let cameras: Vec<Camera> = Camera::read_transforms(&path("scene/transforms.json")).unwrap();
        let cameras: Vec<Camera> = cameras.iter().map(|c| c.scaled(160, 120)).collect();
        write_json(&path("cameras.json"), &transforms(&cameras));
        let text = |name: &str| path(name).display().to_string();
        let answer =
            sgs(&["export", &text("run"), "--web", &text("page"), "--cameras", &text("cameras.json"), "--json"]);
        Exported { answer: answer.ok().json(), folder, cameras }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Writes images of all views by a command and returns that of one view.
    fn image(&self, command: &str, channel: &str, edit: Option<&Value>, view: usize) -> image::RgbImage {
        let to = self.path(&format!("{command}-{}", edit.map_or(String::new(), |e| e.to_string().len().to_string())));
        let (run, cameras, out) = (self.path("run"), self.path("cameras.json"), to.clone());
        let text = |p: &Path| p.display().to_string();
        let mut arguments = vec![command.to_owned(), text(&run), "-o".into(), text(&out)];
        arguments.extend(["--cameras".into(), text(&cameras), "--channels".into(), channel.into(), "--force".into()]);
        if let Some(edit) = edit {
            std::fs::write(self.path("edit.json"), edit.to_string()).unwrap();
            arguments.extend(["--edit".into(), text(&self.path("edit.json"))]);
        }
        sgs(&arguments).ok();
        image::open(to.join(format!("{}_{channel}.png", self.cameras[view].name))).unwrap().to_rgb8()
    }
}

/// Waits until the page has drawn everything.
#[track_caller]
fn settle(browser: &mut Browser) {
    let begun = Instant::now();
    while browser.eval("document.documentElement.dataset.state") != "ready" {
        assert!(begun.elapsed() < Duration::from_secs(100), "the page is never ready: {:?}", browser.complaints());
        std::thread::sleep(Duration::from_millis(50));
    }
}

/// Opens the page at a link in a window of this size. Returns what the window shows.
#[track_caller]
fn shown(browser: &mut Browser, page: &Path, link: &str, [width, height]: [u32; 2]) -> image::RgbImage {
    // Other links of one address do not load it again.
    browser.visit("about:blank", [width, height]);
    browser.visit(&format!("file://{}#{link}", page.join("index.html").display()), [width, height]);
    settle(browser);
    // All requests are for files of the page, or for its own worker.
    let own = format!("asks for file://{}/", page.display());
    let others: Vec<String> =
        browser.complaints().into_iter().filter(|c| !c.starts_with(&own) && !c.starts_with("asks for blob:")).collect();
    assert_eq!(others, [""; 0]);
    let file = tempfile::NamedTempFile::with_suffix(".png").unwrap();
    browser.photograph(false, file.path());
    image::open(file.path()).unwrap().to_rgb8()
}

fn psnr(a: &image::RgbImage, b: &image::RgbImage) -> f64 {
    assert_eq!(a.dimensions(), b.dimensions());
    let square: f64 = a.as_raw().iter().zip(b.as_raw()).map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2)).sum();
    -10.0 * (square / a.as_raw().len() as f64 / 255.0_f64.powi(2)).max(1e-12).log10()
}

#[test]
fn page_shows_a_run_as_the_renderer_does() {
    let exported = Exported::new();
    let answer = &exported.answer;
    assert_eq!((answer["lights"].as_u64(), answer["views"].as_u64()), (Some(3), Some(8)));
    assert!(answer["fit"]["psnr"].as_f64().unwrap() > 35.0, "{answer}");
    let page = exported.path("page");
    let size: u64 = std::fs::read_dir(&page).unwrap().map(|f| f.unwrap().metadata().unwrap().len()).sum();
    assert_eq!(answer["bytes"].as_u64(), Some(size));
    let Some(mut browser) = Browser::start_drawing() else {
        eprintln!("skipped: there is no chromium, so the page was not opened");
        return;
    };
    let size = [160, 120];
    let retained = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let mut compare = |name: &str, link: &str, theirs: &image::RgbImage, bound: f64| {
        let ours = shown(&mut browser, &page, link, size);
        ours.save(retained.join(format!("page-{name}.png"))).unwrap();
        theirs.save(retained.join(format!("page-{name}-renderer.png"))).unwrap();
        let found = psnr(&ours, theirs);
        eprintln!("{name}: {found:.2} dB, images in {}", retained.display());
        assert!(found >= bound, "{name}: {found:.2} dB");
        ours
    };
    let colors = exported.image("render", "rgb", None, 3);
    let here = compare("colors", "view=3&panel=0", &colors, COLORS);
    // Another view is another image.
    assert!(psnr(&here, &exported.image("render", "rgb", None, 0)) < COLORS - 10.0);
    let all = exported.image("relight", "relit", None, 2);
    let edit = json!({"emitters": {"change": [{"emitter": EMITTERS[1], "on": false}]}});
    let without = exported.image("relight", "relit", Some(&edit), 2);
    assert!(psnr(&all, &without) < LIGHTS - 10.0, "the light makes a difference");
    compare("lights", "view=2&lights=1,1,0&panel=0", &all, LIGHTS);
    compare("one-off", "view=2&lights=1,0,0&panel=0", &without, LIGHTS);
    // The last light is off in the run; here it is dimmed, another one has another color.
    let edit = json!({"emitters": {"change": [
        {"emitter": EMITTERS[1], "intensity": 0.5},
        {"emitter": EMITTERS[0], "color": [1.0, 1.0, 0.0]},
        {"emitter": EMITTERS[2], "on": true, "intensity": 2}
    ]}});
    let changed = exported.image("relight", "relit", Some(&edit), 2);
    // Linear 0.5, 0.6, 0 in sRGB. The largest component of the window's own color is 1.
    compare("changed", "view=2&lights=1,0.5,2&colors=bccb00&panel=0", &changed, LIGHTS);
}

/// Sends a press or a release of a key.
fn key(browser: &mut Browser, kind: &str, code: &str) {
    browser.ask("Input.dispatchKeyEvent", json!({"type": kind, "code": code}));
}

/// Presses and releases a key.
fn press(browser: &mut Browser, code: &str) {
    key(browser, "rawKeyDown", code);
    key(browser, "keyUp", code);
}

/// Holds a key until the camera has moved.
#[track_caller]
fn hold(browser: &mut Browser, code: &str) {
    let place = "camera.position.join()";
    let (before, begun) = (browser.eval(place), Instant::now());
    key(browser, "rawKeyDown", code);
    while browser.eval(place) == before {
        assert!(begun.elapsed() < Duration::from_secs(60), "{code} does not move the camera");
        std::thread::sleep(Duration::from_millis(20));
    }
    key(browser, "keyUp", code);
    settle(browser);
}

#[test]
fn visitors_fly_switch_lights_and_share_links() {
    let Some(mut browser) = Browser::start_drawing() else {
        eprintln!("skipped: there is no chromium, so the page was not opened");
        return;
    };
    let exported = Exported::new();
    let page = exported.path("page");
    let start = shown(&mut browser, &page, "view=1", [900, 600]);
    let retained = Path::new(env!("CARGO_TARGET_TMPDIR")).join("page-panel.png");
    start.save(&retained).unwrap();
    eprintln!("the page with its panel is in {}", retained.display());
    let at = |browser: &mut Browser, what: &str| browser.eval(what);
    hold(&mut browser, "KeyW");
    let ahead = "(() => { const v = scene.views[camera.view]; return dot(v.rotation[2], \
                 camera.position.map((p, k) => p - v.position[k])); })()";
    assert!(at(&mut browser, ahead).as_f64().unwrap() > 0.0);
    // A drag to the right turns the camera to the left.
    let turned = "dot(camera.rotation[2], scene.views[camera.view].rotation[0])";
    browser.drag([300.0, 300.0], [360.0, 300.0]);
    settle(&mut browser);
    assert!(at(&mut browser, turned).as_f64().unwrap() < -0.05);
    press(&mut browser, "ArrowRight");
    assert_eq!(
        (at(&mut browser, "camera.view"), at(&mut browser, turned).as_f64().unwrap().abs() < 1e-6),
        (2.into(), true)
    );
    press(&mut browser, "Home");
    assert_eq!(at(&mut browser, "$('view').textContent"), "1 / 8  000");
    // Lights of the run, in order; a switch shows the light of emitters instead of the photographs' colors.
    let names = "[...document.querySelectorAll('#list label')].map((l) => l.textContent.trim()).join('|')";
    assert_eq!(at(&mut browser, names), EMITTERS.join("|"));
    assert_eq!(at(&mut browser, "state.relit || $('lights').hidden"), false);
    browser.eval("document.querySelectorAll('#list input[type=checkbox]')[2].click()");
    browser.eval("$('exposure').value = 1; $('exposure').oninput()");
    settle(&mut browser);
    assert_eq!(at(&mut browser, "state.relit && $('relit').checked && scene.lights[2].on"), true);
    hold(&mut browser, "KeyE");
    assert!(at(&mut browser, "$('frame').textContent").as_str().unwrap().contains("ms"));
    browser.eval("$('link').click()");
    let link = at(&mut browser, "location.hash").as_str().unwrap().to_owned();
    assert!(link.contains("lights=1,1,1") && link.contains("pose=") && link.contains("exposure=1"), "{link}");
    // The link shows the same image, and damaged links show the scene.
    let own = shown(&mut browser, &page, &format!("{}&panel=0", &link[1..]), [300, 200]);
    let again = shown(&mut browser, &page, &format!("{}&panel=0", &link[1..]), [300, 200]);
    assert_eq!(own, again);
    assert!(psnr(&own, &shown(&mut browser, &page, "view=0&panel=0", [300, 200])) < 35.0);
    let plain = shown(&mut browser, &page, "view=0&panel=0", [300, 200]);
    let damaged = "view=x&pose=1,2,NaN&exposure=much&panel=0&colors=zz";
    assert_eq!(shown(&mut browser, &page, damaged, [300, 200]), plain);
}

#[test]
fn page_that_cannot_show_says_so_in_one_sentence() {
    let Some(mut browser) = Browser::start_drawing() else {
        eprintln!("skipped: there is no chromium, so the page was not opened");
        return;
    };
    let exported = Exported::new();
    let page = exported.path("page");
    let mut note = |hide: &str| {
        browser.visit("about:blank", [300, 200]);
        let script = json!({"source": hide});
        let script = browser.ask("Page.addScriptToEvaluateOnNewDocument", script)["identifier"].clone();
        browser.visit(&format!("file://{}", page.join("index.html").display()), [300, 200]);
        let begun = Instant::now();
        while browser.eval("document.documentElement.dataset.state") != "failed" {
            assert!(begun.elapsed() < Duration::from_secs(60), "{:?}", browser.complaints());
            std::thread::sleep(Duration::from_millis(50));
        }
        browser.ask("Page.removeScriptToEvaluateOnNewDocument", json!({"identifier": script}));
        browser.eval("$('note').textContent").as_str().unwrap().to_owned()
    };
    let none = note("HTMLCanvasElement.prototype.getContext = () => null");
    assert!(none.contains("needs WebGL 2") && none.matches('.').count() == 1, "{none}");
    let small = note("WebGL2RenderingContext.prototype.getParameter = () => 0");
    assert!(small.contains("more than the textures of this graphics device hold"), "{small}");
    std::fs::remove_file(page.join("data-0000.js")).unwrap();
    let missing = note("");
    assert_eq!(missing, "The file data-0000.js beside this page is missing; copy the whole folder.");
}

#[test]
fn page_without_cameras_or_lights_is_written_and_bad_targets_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    fabricate_emitting(folder.path());
    let text = |name: &str| folder.path().join(name).display().to_string();
    // A file has neither lights nor cameras.
    let answer = sgs(&["export", &text("run/scene.ply"), "--web", &text("a"), "--json", "--quiet"]).ok().json();
    assert_eq!((answer["lights"].as_u64(), answer["views"].as_u64()), (Some(0), Some(1)));
    let scene = std::fs::read_to_string(folder.path().join("a/scene.js")).unwrap();
    assert!(scene.starts_with("sgs_scene({") && scene.contains("\"overview\""));
    let refused = |arguments: &[&str], words: &[&str]| {
        sgs(&[&["export"], arguments].concat()).refused_with(2, words);
    };
    refused(&[&text("run"), "--web", &text("a")], &["\"", "holds files; name a new or an empty directory"]);
    refused(&[&text("run"), "--web", &text("run")], &["holds files"]);
    refused(&[&text("run"), "--web", &text("run/scene.ply")], &["is a file"]);
    assert_eq!(sgs(&["export", &text("run"), "--web", &text("b"), "-o", &text("b.ply")]).status, Some(2));
    assert_eq!(sgs(&["export", &text("run")]).status, Some(2));
    // The room of emitters is built from the scene.
    std::fs::rename(folder.path().join("scene"), folder.path().join("moved")).unwrap();
    sgs(&["export", &text("run"), "--web", &text("b")]).refused(&["scene", "--scene DIR"]);
    assert!(!folder.path().join("b").exists());
    sgs(&["export", &text("run"), "--web", &text("b"), "--scene", &text("moved")]).ok();
    Splats::default().write_ply(&folder.path().join("none.ply")).unwrap();
    sgs(&["export", &text("none.ply"), "--web", &text("c")]).refused(&["holds no Gaussians"]);
    assert!(!folder.path().join("c").exists());
}
