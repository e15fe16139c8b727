//! Greeting of a provider: its name, version and offers.

use crate::error::Nonsense;
use crate::message::Message;
use serde_json::Value;
use std::collections::BTreeMap;

/// Image encoding that a provider expects.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Encoding {
    /// 8 bits, sRGB-encoded.
    #[default]
    Srgb,
    /// 32-bit floats, linear in light. 1 is the photograph's white; larger values may occur.
    Linear,
}

/// Offer of a provider for one kind of question.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Offer {
    /// Expected image encoding.
    pub image: Encoding,
    /// Longest accepted side of an image in pixels. Larger images are downscaled before sending.
    pub max_side: Option<u32>,
    /// Number of channels of a feature or embedding, where applicable.
    pub channels: usize,
    /// True if a region has the same number in all views of a scene (regions only).
    pub same_ids: bool,
    /// Names of the offered maps (materials only).
    pub maps: Vec<String>,
}

/// Greeting of a provider.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct About {
    /// Name and version, for display.
    pub name: String,
    /// Version of the protocol.
    pub version: u32,
    /// Offers by the name of the question.
    pub offers: BTreeMap<String, Offer>,
}

impl About {
    /// Parses a greeting.
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
        let offers = offers.iter().map(|(op, offer)| Ok((op.clone(), Offer::read(message, offer)?)));
        Ok(About { name, version: version as u32, offers: offers.collect::<Result<_, _>>()? })
    }

    /// Returns the names of the offered questions, separated by commas.
    pub fn list(&self) -> String {
        match self.offers.keys().map(String::as_str).collect::<Vec<_>>()[..] {
            [] => "nothing".to_owned(),
            ref names => names.join(", "),
        }
    }
}

impl Offer {
    /// Parses an offer. Ignores unknown fields.
    fn read(message: &Message, offer: &Value) -> Result<Offer, Nonsense> {
        let wrong = |expected: &str| message.wrong("offers", expected);
        if !offer.is_object() {
            return Err(wrong("an object of objects"));
        }
        let image = match offer.get("image").map(Value::as_str) {
            None => Encoding::Srgb,
            Some(Some("srgb")) => Encoding::Srgb,
            Some(Some("linear")) => Encoding::Linear,
            Some(_) => return Err(wrong("offers whose \"image\" is \"srgb\" or \"linear\"")),
        };
        let whole = |name: &str, lowest: u64| match offer.get(name) {
            None => Ok(None),
            Some(v) => match v.as_u64().filter(|n| (lowest..=1 << 20).contains(n)) {
                Some(n) => Ok(Some(n)),
                None => Err(wrong(&format!("offers whose \"{name}\" is a whole number of at least {lowest}"))),
            },
        };
        let maps =
            offer["maps"].as_array().map(|all| all.iter().filter_map(Value::as_str).map(str::to_owned).collect());
        Ok(Offer {
            image,
            max_side: whole("max_side", 8)?.map(|n| n as u32),
            channels: whole("channels", 1)?.unwrap_or(512) as usize,
            same_ids: offer["ids"] == "scene",
            maps: maps.unwrap_or_default(),
        })
    }
}
