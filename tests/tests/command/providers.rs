//! Providers, each a real `python3`: each kind of misbehavior gets an error of one sentence. No process is left behind.

use sgs_provider::{Encoding, Fallback, Helper, Provider, ProviderError, ProviderImage, ProviderOptions, Result};
use sgs_scene::{DepthMeaning, Image, NormalFrame};
use sgs_tests::priors::provider;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

fn options(how: &str) -> ProviderOptions {
    ProviderOptions { answer_seconds: 60.0, ..ProviderOptions::new(&provider(&format!("misbehave={how}"))) }
}

fn impatient(how: &str) -> ProviderOptions {
    ProviderOptions { answer_seconds: 0.7, ..options(how) }
}

fn image(width: u32, height: u32) -> Image {
    let data = (0..width * height * 3).map(|i| (i % 256) as f32 / 255.0).collect();
    Image::from_data(width, height, 3, data).unwrap()
}

/// Requests normals of a small image.
fn ask(options: &ProviderOptions) -> Result<sgs_provider::Normals> {
    Provider::start(options)?.normals(&ProviderImage::srgb(&image(6, 4)))
}

/// Returns an error's message with the provider's command replaced. Fails unless the message names the command and is a
/// single line of less than 900 bytes.
#[track_caller]
fn sentence(options: &ProviderOptions, error: ProviderError) -> String {
    let text = error.to_string();
    assert!(text.len() < 900 && !text.contains('\n'), "{text}");
    let quoted = format!("\"{}\"", options.command);
    assert!(text.contains(&quoted), "{text}");
    text.replace(&quoted, "it")
}

#[track_caller]
fn fail(how: &str) -> String {
    let options = options(how);
    sentence(&options, ask(&options).unwrap_err())
}

#[test]
fn working_provider_answers() {
    let options = options("nothing");
    let mut provider = Provider::start(&options).unwrap();
    assert_eq!(provider.about().name, "misbehave nothing");
    assert_eq!(provider.about().list(), "depth, masks, materials, normals, regions, semantics, text");
    let rendered = image(6, 4);
    let rendered = ProviderImage::srgb(&rendered);
    let normals = provider.normals(&rendered).unwrap();
    assert_eq!((normals.frame, normals.image.pixel(5, 3)), (NormalFrame::CameraOpengl, &[0.0, 0.0, 1.0][..]));
    let depth = provider.depth(&rendered).unwrap();
    assert_eq!((depth.meaning, depth.image.data), (DepthMeaning::Scale, vec![2.0; 24]));
    assert_eq!(depth.confidence.unwrap().data, [0.5; 24]);
    assert_eq!(provider.regions(&rendered).unwrap().ids, [1; 24]);
    assert_eq!(provider.semantics(&rendered).unwrap().shape, [1, 1, 512]);
    let frames = [rendered.clone(), rendered.clone(), rendered.clone()];
    let masks = provider.masks(&frames, Some([2.5, 1.5])).unwrap();
    assert!(masks.size == [6, 4] && masks.frames.iter().all(|f| *f == [true; 24]));
    let (channels, embeddings) = provider.text(&["chair".into(), "Löwe \"x\"".into()]).unwrap();
    assert_eq!((channels, embeddings.len()), (512, 1024));
    let found = provider.materials(&rendered, &["albedo", "metallic"]).unwrap();
    assert!(!found.albedo_is_linear && found.albedo.is_some() && found.metallic.is_some() && found.roughness.is_none());
    let error = sentence(&options, provider.classes(std::slice::from_ref(&rendered)).unwrap_err());
    let offers = "depth, masks, materials, normals, regions, semantics, text";
    assert_eq!(error, format!("the provider it does not offer classes; it offers {offers}"));
    let other = image(5, 4);
    let error =
        provider.masks(&[rendered.clone(), ProviderImage::srgb(&other), rendered], None).unwrap_err().to_string();
    assert_eq!(error, "masks cannot be asked: the frames differ in size");
}

#[test]
fn images_are_sent_in_the_requested_format() {
    let mut provider = Provider::start(&options("linear")).unwrap();
    let offer = provider.about().offers["normals"].clone();
    assert_eq!((offer.image, offer.max_side), (Encoding::Linear, Some(16)));
    // The answer has the size of the image that was sent.
    let normals = provider.normals(&ProviderImage::srgb(&image(40, 20))).unwrap();
    assert_eq!((normals.image.width, normals.image.height), (16, 8));
}

#[test]
fn invalid_provider_commands_are_refused() {
    let fail = |command: &str| Provider::start(&ProviderOptions::new(command)).err().unwrap().to_string();
    assert!(fail("").contains("the provider's command \"\" names no program; give one, as"));
    assert!(fail("python3 'x").contains("has a quote that is not closed"));
    let error = fail("/nowhere/at-all --x");
    assert_eq!(error, "the provider \"/nowhere/at-all --x\" cannot be started: No such file or directory (os error 2)");
    assert!(fail("/etc").contains("cannot be started: Permission denied"));
}

#[test]
fn provider_exit_is_reported() {
    let message = "the provider it ended with status 3 before it answered normals; its last words: CUDA out of memory";
    assert_eq!(fail("exit"), message);
    assert_eq!(fail("exit-quietly"), "the provider it ended with status 0 before it answered normals");
    assert_eq!(fail("signal"), "the provider it was ended by signal 9 before it answered normals");
    assert_eq!(fail("greeting-exit"), message.replace("normals", "the greeting"));
    assert_eq!(
        fail("crash-amid"),
        "the provider it ended with status 1 in the middle of a message before it answered normals; its last words: \
         segmentation fault, or so"
    );
    let options = ProviderOptions::new("true");
    let message = sentence(&options, ask(&options).unwrap_err());
    assert_eq!(message, "the provider it ended with status 0 before it answered the greeting");
}

#[test]
fn provider_that_closes_stdout_is_reported() {
    let begun = Instant::now();
    assert_eq!(fail("close-output"), "the provider it closed its output before it answered normals");
    assert!(begun.elapsed() < Duration::from_secs(30));
}

#[test]
fn hung_provider_times_out() {
    for how in ["hang", "hang-deaf", "hang-amid", "flood-forever"] {
        let options = impatient(how);
        let begun = Instant::now();
        let message = sentence(&options, ask(&options).unwrap_err());
        let start = "the provider it gave no answer to normals within 0.7 s and was stopped; allow more time";
        assert!(message.starts_with(start), "{how}: {message}");
        assert_eq!(message.contains("still loading"), how == "flood-forever", "{message}");
        assert!(begun.elapsed() < Duration::from_secs(30), "{how} took {:?}", begun.elapsed());
    }
    let options = ProviderOptions { start_seconds: 0.7, ..options("greeting-hang") };
    let message = sentence(&options, ask(&options).unwrap_err());
    assert!(
        message.starts_with("the provider it gave no answer to the greeting within 0.7 s and was stopped"),
        "{message}"
    );
}

#[test]
fn provider_that_stops_reading_times_out() {
    let options = impatient("stop-reading");
    let mut provider = Provider::start(&options).unwrap();
    let large = image(600, 400);
    let message = sentence(&options, provider.normals(&ProviderImage::srgb(&large)).unwrap_err());
    assert!(message.starts_with("the provider it gave no answer to normals within 0.7 s"), "{message}");
    let message = sentence(&options, provider.normals(&ProviderImage::srgb(&large)).unwrap_err());
    assert_eq!(message, "the provider it has been stopped after an earlier failure");
}

#[test]
fn slow_and_verbose_providers_are_read_to_the_end() {
    for how in ["flood", "long-line", "trickle"] {
        let normals = ask(&options(how)).unwrap_or_else(|e| panic!("{how}: {e}"));
        assert_eq!(normals.image.data.len(), 72, "{how}");
    }
    // Large requests and answers travel in both directions at once.
    let mut provider = Provider::start(&options("nothing")).unwrap();
    let large = image(900, 700);
    assert_eq!(provider.normals(&ProviderImage::srgb(&large)).unwrap().image.data.len(), 900 * 700 * 3);
}

#[test]
fn malformed_answers_are_reported() {
    let nonsense = |how: &str, what: &str| {
        let message = fail(how);
        let (begin, rest) =
            message.split_once(" answered normals with nonsense and was stopped: ").unwrap_or((&message, ""));
        assert_eq!((begin, rest), ("the provider it", what), "{how}");
    };
    nonsense(
        "garbage",
        "a message begins with \"SGSP\", but there was \"Loading checkpoint shard\"; nothing else may go to its standard \
         output",
    );
    nonsense("huge-length", "a message of 1152921504606846976 bytes is announced, but at most 1073741824 are taken");
    nonsense("over-limit", "a message of 1073741825 bytes is announced, but at most 1073741824 are taken");
    nonsense("no-text", "the message's text is absent; it belongs into the metadata as \"sgs\"");
    nonsense("not-an-object", "the message's text is not a JSON object");
    nonsense("wrong-shape", "the array \"normals\" has the shape [3, 6, 4], but must have [4, 6, 3]");
    nonsense("wrong-type", "the array \"normals\" holds U8, but must hold F32");
    nonsense("wrong-id", "the field \"to\" must be 1, the question's id, but is 2");
    nonsense("wrong-kind", "the field \"kind\" must be \"answer\" or \"error\", but is \"applause\"");
    nonsense("infinite", "the array \"normals\" holds inf at index 2, but must hold numbers that are not infinite");
    let frames = "\"world\", \"camera-opencv\", \"camera-opengl\" or \"camera-stablenormal\"";
    nonsense("wrong-frame", &format!("the field \"frame\" must be {frames}, but is \"sideways\""));
    nonsense("no-frame", &format!("the field \"frame\" must be {frames}, but is absent"));
    for (how, what) in [
        ("not-safetensors", "the message is no safetensors file ("),
        ("short-payload", "the message is no safetensors file ("),
        ("not-json", "the message's text is not JSON ("),
        ("missing-array", "the array \"normals\" is missing; there is \"albedo\", \"confidence\", "),
        ("unknown-type", "the array \"normals\" is missing; there is \"albedo\", \"confidence\", "),
    ] {
        let message = fail(how);
        assert!(message.contains(&format!("nonsense and was stopped: {what}")), "{how}: {message}");
    }
}

#[test]
fn malformed_answers_of_other_kinds_are_reported() {
    let rendered = image(6, 4);
    let rendered = ProviderImage::srgb(&rendered);
    let start = |how: &str| Provider::start(&options(how)).unwrap();
    let message = |how: &str, error: ProviderError| sentence(&options(how), error);
    let error = start("nan").semantics(&rendered).unwrap_err();
    assert!(
        message("nan", error).ends_with("the array \"features\" holds NaN at index 2, but must hold finite numbers")
    );
    let frames = [rendered.clone(), rendered.clone(), rendered.clone()];
    let error = start("bool-two").masks(&frames, None).unwrap_err();
    assert!(message("bool-two", error).ends_with("the array \"masks\" holds 2 at index 0, but must hold only 0 and 1"));
    let error = start("wrong-names").text(&["a".into()]).unwrap_err();
    assert!(message("wrong-names", error).contains("must be the names that were asked about"));
    let error = start("wrong-color").materials(&rendered, &["albedo"]).unwrap_err();
    assert!(message("wrong-color", error).ends_with("must be \"srgb\" or \"linear\", but is \"cmyk\""));
    let error = start("wrong-meaning").depth(&rendered).unwrap_err();
    let words = "\"metric\", \"scale\" or \"inverse-scale-shift\"";
    assert!(message("wrong-meaning", error).ends_with(&format!("\"meaning\" must be {words}, but is \"near\"")));
    let error = start("wrong-confidence").depth(&rendered).unwrap_err();
    assert!(message("wrong-confidence", error).ends_with("holds 1.5 at index 0, but must hold numbers from 0 to 1"));
    assert!(start("nan").depth(&rendered).unwrap().image.data[2].is_nan());
    // Where the protocol allows NaN, NaN marks unknown values.
    assert_eq!(start("nan").normals(&rendered).unwrap().image.data[..6], [0.0, 0.0, 0.0, 0.0, 0.0, 1.0]);
    let albedo = start("nan").materials(&rendered, &["albedo"]).unwrap().albedo.unwrap();
    assert!(albedo.data[2].is_nan() && albedo.data[3] == 0.5);
}

#[test]
fn greetings_are_checked() {
    for (how, what) in [
        ("old-version", "it speaks version 0 of the protocol, but 1 to 1 are spoken here"),
        ("new-version", "it speaks version 99 of the protocol, but 1 to 1 are spoken here"),
        ("no-hello", "the field \"kind\" must be \"hello\", but is \"answer\""),
        ("no-version", "the field \"version\" must be a whole number, but is absent"),
        ("print", "a message begins with \"SGSP\", but there was \"a library says hello"),
        ("greeting-garbage", "a message begins with \"SGSP\", but there was \"Loading"),
    ] {
        let message = fail(how);
        assert!(
            message.starts_with("the provider it answered the greeting with nonsense and was stopped: "),
            "{message}"
        );
        assert!(message.contains(what), "{how}: {message}");
    }
    assert!(
        fail("wrong-offer").contains("the field \"offers\" must be offers whose \"image\" is \"srgb\" or \"linear\"")
    );
    let message = fail("cannot-load");
    assert_eq!(message, "the provider it cannot answer the greeting: there are no weights at /nowhere");
    assert_eq!(fail("few-offers"), "the provider it does not offer normals; it offers text");
}

#[test]
fn provider_survives_a_refused_request() {
    let options = options("refuse");
    let mut provider = Provider::start(&options).unwrap();
    for _ in 0..2 {
        let error = provider.normals(&ProviderImage::srgb(&image(6, 4))).unwrap_err();
        assert_eq!(sentence(&options, error), "the provider it cannot answer normals: no such thing is known");
    }
}

/// Counts the processes with a given word among their arguments.
fn running(word: &str) -> usize {
    let entries = std::fs::read_dir("/proc").unwrap().flatten();
    let alive = |pid: &std::path::Path| {
        let arguments = std::fs::read(pid.join("cmdline")).unwrap_or_default();
        String::from_utf8_lossy(&arguments).split('\0').any(|a| a == word)
    };
    entries.filter(|e| alive(&e.path())).count()
}

#[test]
fn provider_process_ends_on_drop() {
    // The provider ends with its input, ignores its end, is busy with a request, or has a child process.
    for how in ["nothing", "stay", "hang", "hang-deaf"] {
        let mark = format!("--code={how}-{}", std::process::id());
        let mut options = impatient(how);
        options.command = format!("{} {mark}", options.command);
        let mut provider = Provider::start(&options).unwrap();
        assert_eq!(running(&mark), 1, "the check itself");
        let _ = provider.normals(&ProviderImage::srgb(&image(6, 4)));
        let begun = Instant::now();
        drop(provider);
        // All are killed, but a grandchild may take a moment to exit.
        while running(&mark) > 0 && begun.elapsed() < Duration::from_secs(20) {
            std::thread::sleep(Duration::from_millis(5));
        }
        assert_eq!(running(&mark), 0, "{how}");
        assert!(begun.elapsed() < Duration::from_secs(20), "{how}");
    }
}

/// Returns the log of this thread while `run` runs.
fn logged(run: impl FnOnce()) -> String {
    #[derive(Clone, Default)]
    struct Sink(Arc<Mutex<Vec<u8>>>);
    impl std::io::Write for Sink {
        fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
            self.0.lock().unwrap().extend(bytes);
            Ok(bytes.len())
        }
        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }
    let sink = Sink::default();
    let writer = sink.clone();
    let subscriber = tracing_subscriber::fmt().with_ansi(false).with_writer(move || writer.clone()).finish();
    tracing::subscriber::with_default(subscriber, run);
    String::from_utf8(sink.0.lock().unwrap().clone()).unwrap()
}

#[test]
fn standard_error_goes_to_the_log() {
    let log = logged(|| {
        let _ = ask(&options("exit"));
        let _ = ask(&options("flood"));
    });
    assert!(log.contains("INFO provider: CUDA out of memory\n"), "{log}");
    assert!(log.contains("INFO provider: line 0 of a talkative") && log.contains("line 19999 of"), "lines are missing");
}

#[test]
fn optional_provider_failure_is_logged_once() {
    let rendered = image(6, 4);
    let rendered = ProviderImage::srgb(&rendered);
    let log = logged(|| {
        let mut helper = Helper::start(&options("exit"), Fallback::GoOn).unwrap();
        assert!(helper.is_there());
        for _ in 0..3 {
            assert!(helper.ask(|p| p.normals(&rendered)).unwrap().is_none());
            assert!(!helper.is_there());
        }
    });
    assert_eq!(log.matches("WARN").count(), 1, "{log}");
    assert!(log.contains("its last words: CUDA out of memory; going on without it"), "{log}");

    let missing = ProviderOptions::new("/nowhere/at-all");
    let log = logged(|| assert!(!Helper::start(&missing, Fallback::GoOn).unwrap().is_there()));
    assert_eq!(log.matches("going on without it").count(), 1, "{log}");
    assert!(Helper::start(&missing, Fallback::Stop).is_err());

    let mut helper = Helper::start(&options("exit"), Fallback::Stop).unwrap();
    assert!(helper.ask(|p| p.normals(&rendered)).is_err());
    let mut helper = Helper::start(&options("nothing"), Fallback::Stop).unwrap();
    assert!(helper.ask(|p| p.normals(&rendered)).unwrap().is_some());
}
