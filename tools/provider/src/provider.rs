//! Provider and its questions.

use crate::array::Array;
use crate::error::{Nonsense, ProviderError, Result};
use crate::frame::framed;
use crate::kind::Kind;
use crate::message::Message;
use crate::offer::{About, Offer};
use crate::options::ProviderOptions;
use crate::pipe::{Broken, Pipe};
use crate::question::{Depth, Features, Masks, Materials, Normals, ProviderImage, Regions, stretch, unit};
use crate::words::words;
use serde::Deserialize;
use serde_json::{Value, json};
use sgs_scene::{DepthMeaning, Image, NormalFrame};
use std::time::Duration;

/// Running provider.
///
/// Dropping a provider closes its input, waits up to two seconds for its end, and then kills it.
pub struct Provider {
    pipe: Option<Pipe>,
    options: ProviderOptions,
    about: About,
    requested: u64,
}

impl Provider {
    /// Starts a provider and exchanges greetings.
    ///
    /// # Errors
    /// If the command is invalid, cannot be started, or sends no valid greeting in time.
    pub fn start(options: &ProviderOptions) -> Result<Provider> {
        let command = options.command.clone();
        let words = words(&command).map_err(|problem| ProviderError::Command { command: command.clone(), problem })?;
        let pipe = Pipe::start(&words, options.limit).map_err(|cause| ProviderError::Start { command, cause })?;
        let mut provider =
            Provider { pipe: Some(pipe), options: options.clone(), about: About::default(), requested: 0 };
        let [lowest, highest] = crate::VERSIONS;
        let program = concat!("sgs ", env!("CARGO_PKG_VERSION"));
        let hello = Message::new(json!({"kind": "hello", "versions": [lowest, highest], "program": program}));
        let greeting = provider.exchange("the greeting", &hello, options.start_seconds)?;
        if greeting.text["kind"] == "error" {
            let text = refusal(&greeting);
            provider.end();
            return Err(ProviderError::Refused { command: options.command.clone(), question: "the greeting", text });
        }
        provider.about = About::read(&greeting).or_else(|what| provider.nonsense("the greeting", what))?;
        tracing::info!("provider {} offers {}", provider.about.name, provider.about.list());
        Ok(provider)
    }

    /// Returns the provider's greeting.
    pub fn about(&self) -> &About {
        &self.about
    }

    /// Returns true if the provider offers a question.
    pub fn offers(&self, question: &str) -> bool {
        self.about.offers.contains_key(question)
    }

    /// Segments the object at `point` in three frames of one size.
    ///
    /// `point` is x right, y down, in pixels of the first frame. Without a point the provider chooses the object.
    pub fn masks(&mut self, frames: &[ProviderImage; 3], point: Option<[f64; 2]>) -> Result<Masks> {
        const Q: &str = "masks";
        let offer = self.offer(Q)?;
        let size = [frames[0].image.width, frames[0].image.height];
        if frames.iter().any(|f| [f.image.width, f.image.height] != size) {
            return Err(ProviderError::Question { question: Q, problem: "the frames differ in size".into() });
        }
        let sent = frames[0].sent_size(&offer);
        let factor = [0, 1].map(|axis| f64::from(sent[axis]) / f64::from(size[axis]));
        let extra = match point {
            Some([x, y]) => json!({"point": [x * factor[0], y * factor[1]]}),
            None => json!({}),
        };
        let mut answer = self.ask(Q, &offer, frames, extra)?;
        let [w, h] = sent.map(|n| n as usize);
        let masks = answer.take("masks", Kind::Bool, &[3, h, w]).or_else(|what| self.nonsense(Q, what))?;
        let frame = |i: usize| stretch(&masks.bytes[i * w * h..(i + 1) * w * h], sent, size);
        Ok(Masks { size, frames: [frame(0), frame(1), frame(2)] })
    }

    /// Returns all regions of an image.
    pub fn regions(&mut self, rendered: &ProviderImage) -> Result<Regions> {
        const Q: &str = "regions";
        let offer = self.offer(Q)?;
        let size = rendered.sent_size(&offer);
        let mut answer = self.ask(Q, &offer, std::slice::from_ref(rendered), json!({}))?;
        let shape = [size[1] as usize, size[0] as usize];
        let ids = answer.take("regions", Kind::U16, &shape).or_else(|what| self.nonsense(Q, what))?;
        Ok(Regions { size, ids: ids.words() })
    }

    /// Returns the normals of an image.
    pub fn normals(&mut self, rendered: &ProviderImage) -> Result<Normals> {
        const Q: &str = "normals";
        let offer = self.offer(Q)?;
        let size = rendered.sent_size(&offer);
        let mut answer = self.ask(Q, &offer, std::slice::from_ref(rendered), json!({}))?;
        let read = |answer: &mut Message| {
            let frame = NormalFrame::deserialize(&answer.text["frame"]);
            let known = "\"world\", \"camera-opencv\", \"camera-opengl\" or \"camera-stablenormal\"";
            let frame = frame.map_err(|_| answer.wrong("frame", known))?;
            let array = answer.take("normals", Kind::F32, &[size[1] as usize, size[0] as usize, 3])?;
            Ok(Normals { frame, image: unit(&array, size)? })
        };
        read(&mut answer).or_else(|what| self.nonsense(Q, what))
    }

    /// Returns the depth of an image, and its confidence if the provider has one.
    pub fn depth(&mut self, rendered: &ProviderImage) -> Result<Depth> {
        const Q: &str = "depth";
        let offer = self.offer(Q)?;
        let size = rendered.sent_size(&offer);
        let mut answer = self.ask(Q, &offer, std::slice::from_ref(rendered), json!({}))?;
        let read = |answer: &mut Message| {
            let known = "\"metric\", \"scale\" or \"inverse-scale-shift\"";
            let meaning =
                DepthMeaning::deserialize(&answer.text["meaning"]).map_err(|_| answer.wrong("meaning", known))?;
            let shape = [size[1] as usize, size[0] as usize];
            let image = |array: &Array| Image { width: size[0], height: size[1], channels: 1, data: array.floats() };
            let depth = answer.take("depth", Kind::F32, &shape)?;
            depth.check("depth", "numbers that are not infinite", |v| !v.is_infinite())?;
            let confidence = if answer.arrays.contains_key("confidence") {
                let array = answer.take("confidence", Kind::F32, &shape)?;
                array.check("confidence", "numbers from 0 to 1", |v| (0.0..=1.0).contains(&v))?;
                Some(image(&array))
            } else {
                None
            };
            Ok(Depth { meaning, image: image(&depth), confidence })
        };
        read(&mut answer).or_else(|what| self.nonsense(Q, what))
    }

    /// Returns the features of an image, on a grid of the provider's choice.
    pub fn semantics(&mut self, rendered: &ProviderImage) -> Result<Features> {
        const Q: &str = "semantics";
        let offer = self.offer(Q)?;
        let mut answer = self.ask(Q, &offer, std::slice::from_ref(rendered), json!({}))?;
        let read = |answer: &mut Message| {
            let array = answer.take("features", Kind::F16, &[0, 0, offer.channels])?;
            array.check("features", "finite numbers", f32::is_finite)?;
            Ok(Features { shape: [array.shape[0], array.shape[1], array.shape[2]], data: array.halves() })
        };
        read(&mut answer).or_else(|what| self.nonsense(Q, what))
    }

    /// Returns the number of channels and one embedding per name, concatenated.
    pub fn text(&mut self, names: &[String]) -> Result<(usize, Vec<f32>)> {
        const Q: &str = "text";
        let offer = self.offer(Q)?;
        let mut answer = self.ask(Q, &offer, &[], json!({"names": names}))?;
        let read = |answer: &mut Message| {
            if answer.strings("names")? != names {
                return Err(answer.wrong("names", "the names that were asked about"));
            }
            let array = answer.take("embeddings", Kind::F32, &[names.len(), offer.channels])?;
            array.check("embeddings", "finite numbers", f32::is_finite)?;
            Ok((offer.channels, array.floats()))
        };
        read(&mut answer).or_else(|what| self.nonsense(Q, what))
    }

    /// Returns names for the classes of objects in the images.
    pub fn classes(&mut self, images: &[ProviderImage]) -> Result<Vec<String>> {
        const Q: &str = "classes";
        let offer = self.offer(Q)?;
        let answer = self.ask(Q, &offer, images, json!({}))?;
        let names = answer.strings("names").or_else(|what| self.nonsense(Q, what))?;
        if names.is_empty() || names.iter().any(|n| n.trim().is_empty()) {
            return self.nonsense(Q, answer.wrong("names", "a list of names, none of them empty"));
        }
        Ok(names)
    }

    /// Returns material maps of an image: some of "albedo", "roughness", "metallic".
    pub fn materials(&mut self, rendered: &ProviderImage, maps: &[&str]) -> Result<Materials> {
        const Q: &str = "materials";
        let offer = self.offer(Q)?;
        let size = rendered.sent_size(&offer);
        let mut answer = self.ask(Q, &offer, std::slice::from_ref(rendered), json!({"maps": maps}))?;
        let read = |answer: &mut Message| {
            let mut found = Materials::default();
            for map in maps {
                let channels = if *map == "albedo" { 3 } else { 1 };
                let shape = [size[1] as usize, size[0] as usize, channels];
                let array = answer.take(map, Kind::F32, if channels == 1 { &shape[..2] } else { &shape })?;
                array.check(map, "numbers that are not infinite", |v| !v.is_infinite())?;
                let image = Image { width: size[0], height: size[1], channels: channels as u32, data: array.floats() };
                match *map {
                    "albedo" => found.albedo = Some(image),
                    "roughness" => found.roughness = Some(image),
                    _ => found.metallic = Some(image),
                }
            }
            if found.albedo.is_some() {
                found.albedo_is_linear = match answer.string("color", "\"srgb\" or \"linear\"")? {
                    "linear" => true,
                    "srgb" => false,
                    _ => return Err(answer.wrong("color", "\"srgb\" or \"linear\"")),
                };
            }
            Ok(found)
        };
        read(&mut answer).or_else(|what| self.nonsense(Q, what))
    }

    /// Returns the offer for a question.
    fn offer(&self, question: &'static str) -> Result<Offer> {
        self.about.offers.get(question).cloned().ok_or_else(|| ProviderError::NotOffered {
            command: self.options.command.clone(),
            question,
            offers: self.about.list(),
        })
    }

    /// Sends a question and accepts only an answer or a refusal to it.
    fn ask(
        &mut self,
        question: &'static str,
        offer: &Offer,
        images: &[ProviderImage],
        extra: Value,
    ) -> Result<Message> {
        if let Some(problem) = images.iter().find_map(ProviderImage::problem) {
            return Err(ProviderError::Question { question, problem });
        }
        self.requested += 1;
        let views: Vec<Value> = images.iter().map(|p| p.hints(offer)).collect();
        let mut text = json!({
            "kind": "question", "id": self.requested, "question": question, "views": views, "seed": self.options.seed,
        });
        for (name, value) in extra.as_object().into_iter().flatten() {
            text[name.as_str()] = value.clone();
        }
        let mut message = Message::new(text);
        let arrays = images.iter().enumerate().map(|(i, p)| (format!("image{i}"), p.array(offer)));
        message.arrays = arrays.collect::<std::collections::BTreeMap<String, Array>>();
        let answer = self.exchange(question, &message, self.options.answer_seconds)?;
        if answer.text["to"].as_u64() != Some(self.requested) {
            return self.nonsense(question, answer.wrong("to", &format!("{}, the question's id", self.requested)));
        }
        match answer.text["kind"].as_str() {
            Some("answer") => Ok(answer),
            Some("error") => {
                let (command, text) = (self.options.command.clone(), refusal(&answer));
                Err(ProviderError::Refused { command, question, text })
            }
            _ => self.nonsense(question, answer.wrong("kind", "\"answer\" or \"error\"")),
        }
    }

    fn exchange(&mut self, question: &'static str, message: &Message, seconds: f64) -> Result<Message> {
        let command = self.options.command.clone();
        let Some(pipe) = &mut self.pipe else { return Err(ProviderError::Stopped { command }) };
        let out = framed(message).map_err(|what| ProviderError::Question { question, problem: what.to_string() })?;
        let limit = Duration::try_from_secs_f64(seconds).unwrap_or(Duration::MAX).min(Duration::from_secs(1 << 30));
        let broken = match pipe.exchange(&out, limit) {
            Ok(answer) => return Ok(answer),
            Err(broken) => broken,
        };
        let last = pipe.last().to_owned();
        self.end();
        Err(match broken {
            Broken::Ended(how) => ProviderError::Ended { command, how, question, last },
            Broken::TimeOut => ProviderError::TimeOut { command, question, seconds, last },
            Broken::Nonsense(what) => ProviderError::Nonsense { command, question, what },
        })
    }

    /// Stops the provider after invalid output, because later output cannot be trusted.
    fn nonsense<T>(&mut self, question: &'static str, what: Nonsense) -> Result<T> {
        self.end();
        Err(ProviderError::Nonsense { command: self.options.command.clone(), question, what })
    }

    /// Stops the provider without waiting.
    fn end(&mut self) {
        self.pipe = None;
    }
}

impl Drop for Provider {
    fn drop(&mut self) {
        if let Some(pipe) = &mut self.pipe {
            pipe.finish();
        }
    }
}

/// Returns the reason of a refusal, on one line and at most 500 characters long.
fn refusal(message: &Message) -> String {
    let text = message.text["text"].as_str().unwrap_or("it gives no reason");
    text.split_whitespace().collect::<Vec<_>>().join(" ").chars().take(500).collect()
}
