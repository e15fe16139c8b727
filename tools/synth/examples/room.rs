//! Generates a scene: `room OUT [scene=NAME] [views=N] [test=N] [size=WxH] [seed=N] [spp=N] [points=N] [raw]`.

use std::error::Error;
use std::path::PathBuf;

use sgs_synth::{SynthOptions, generate};

fn main() -> Result<(), Box<dyn Error>> {
    let mut args = std::env::args().skip(1);
    let out = PathBuf::from(args.next().ok_or("usage: room OUT [key=value]...")?);
    let mut options = SynthOptions { replace: true, ..SynthOptions::default() };
    for arg in args {
        let (key, value) = arg.split_once('=').unwrap_or((arg.as_str(), ""));
        match key {
            "scene" => options.scene = value.parse()?,
            "views" => options.views = value.parse()?,
            "test" => options.test_views = value.parse()?,
            "seed" => options.seed = value.parse()?,
            "spp" => options.samples_per_pixel = value.parse()?,
            "points" => options.points = value.parse()?,
            "raw" => options.denoise = false,
            "size" => {
                let (w, h) = value.split_once('x').ok_or("size=WxH")?;
                (options.width, options.height) = (w.parse()?, h.parse()?);
            }
            _ => return Err(format!("unknown option {key}").into()),
        }
    }
    let summary = generate(&out, &options, &|done, total| {
        if done == total {
            eprintln!("rendered {total} rows");
        }
    })?;
    println!("{summary:#?}");
    Ok(())
}
