//! What a provider says about itself in its greeting.

use crate::error::Nonsense;
use crate::message::Message;
use serde_json::Value;
use std::collections::BTreeMap;

/// How a provider wants its images.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Encoding {
    /// 8 bits, sRGB-encoded.
    #[default]
    Srgb,
    /// 32-bit floats, proportional to light; 1 is the photograph's white, and there may be more.
    Linear,
}

/// What a provider says about one kind of question.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Offer {
    /// How it wants images.
    pub image: Encoding,
    /// The longest side of an image that it wants; larger ones are made smaller before they are sent.
    pub max_side: Option<u32>,
    /// Numbers for each feature or embedding, where it gives such.
    pub channels: usize,
    /// Whether the same region has the same number in all views of a scene (regions only).
    pub same_ids: bool,
    /// Which maps there are (materials only).
    pub maps: Vec<String>,
}

/// A provider's greeting.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct About {
    /// Its name and version, for people.
    pub name: String,
    /// The version of the protocol it speaks.
    pub version: u32,
    /// What it offers, by the name of the question.
    pub offers: BTreeMap<String, Offer>,
}

impl About {
    /// From a greeting.
    pub(crate) fn read(message: &Message) -> Result<About, Nonsense> {
        if message.text["kind"] != "hello" {
            return Err(message.wrong("kind", "\"hello\""));
        }
        let version = message.text["version"].as_u64().ok_or_else(|| message.wrong("version", "a whole number"))?;
        let [lowest, highest] = crate::VERSIONS.map(u64::from);
        if !(lowest..=highest).contains(&version) {
            return Err(Nonsense::Version { theirs: version });
        }
        let name = message.string("name", "a text")?.chars().take(200).collect();
        let offers = message.text["offers"].as_object().ok_or_else(|| message.wrong("offers", "an object"))?;
        let offers = offers.iter().map(|(op, said)| Ok((op.clone(), Offer::read(message, said)?)));
        Ok(About { name, version: version as u32, offers: offers.collect::<Result<_, _>>()? })
    }

    /// What is offered, as words.
    pub fn list(&self) -> String {
        match self.offers.keys().map(String::as_str).collect::<Vec<_>>()[..] {
            [] => "nothing".to_owned(),
            ref names => names.join(", "),
        }
    }
}

impl Offer {
    /// From an object; fields that are not known here are left alone.
    fn read(message: &Message, said: &Value) -> Result<Offer, Nonsense> {
        let wrong = |expected: &str| message.wrong("offers", expected);
        if !said.is_object() {
            return Err(wrong("an object of objects"));
        }
        let image = match said.get("image").map(Value::as_str) {
            None => Encoding::Srgb,
            Some(Some("srgb")) => Encoding::Srgb,
            Some(Some("linear")) => Encoding::Linear,
            Some(_) => return Err(wrong("offers whose \"image\" is \"srgb\" or \"linear\"")),
        };
        let whole = |name: &str, lowest: u64| match said.get(name) {
            None => Ok(None),
            Some(v) => match v.as_u64().filter(|n| (lowest..=1 << 20).contains(n)) {
                Some(n) => Ok(Some(n)),
                None => Err(wrong(&format!("offers whose \"{name}\" is a whole number of at least {lowest}"))),
            },
        };
        let maps = said["maps"].as_array().map(|all| all.iter().filter_map(Value::as_str).map(str::to_owned).collect());
        Ok(Offer {
            image,
            max_side: whole("max_side", 8)?.map(|n| n as u32),
            channels: whole("channels", 1)?.unwrap_or(512) as usize,
            same_ids: said["ids"] == "scene",
            maps: maps.unwrap_or_default(),
        })
    }
}
