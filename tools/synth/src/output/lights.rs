//! Ground-truth lights and the relightings of the test views.

use glam::Vec3;
use serde_json::{Map, Value, json};

use crate::scene::light::{Emission, Light, Shape};
use crate::scene::sky::Sun;
use crate::scene::{MAX_GROUPS, Scene, added};

/// Lighting that differs from training: a factor for each light group, and perhaps one more light.
pub(crate) struct Relighting {
    /// Name of the folder under `gt/relit`.
    pub(crate) name: &'static str,
    /// Factors by group.
    pub(crate) weights: [Vec3; MAX_GROUPS],
    /// Scene with other light: with a lamp that training lacks, its last; with a sun, or with another environment.
    pub(crate) room: Option<Scene>,
    /// File of the environment under `gt`.
    pub(crate) environment: String,
}

/// File of the environment of the training views under `gt`.
pub(crate) const ENVIRONMENT: &str = "environment.exr";

/// Relighting under an environment that training lacks.
const SKY_TURNED: &str = "sky_turned";

/// Returns the relightings of a scene.
pub(crate) fn relightings(scene: &Scene) -> Vec<Relighting> {
    let groups = &scene.groups;
    let lamps = groups.iter().filter(|g| !g.window).count();
    let windows = groups.len() - lamps;
    let mut out = Vec::new();
    let mut add = |name: &'static str, weight: &dyn Fn(usize) -> Vec3| {
        let mut weights = [Vec3::ONE; MAX_GROUPS];
        for (group, w) in weights.iter_mut().enumerate().take(groups.len()) {
            *w = weight(group);
        }
        out.push(Relighting { name, weights, room: None, environment: ENVIRONMENT.to_owned() });
    };
    if lamps > 0 && groups.len() > 1 {
        if let Some(ceiling) = groups.iter().position(|g| g.name == "lamp_ceiling") {
            add("lamp_ceiling_off", &|g| {
                if g == ceiling { Vec3::ZERO } else { Vec3::ONE }
            });
        }
        let colors = [Vec3::new(0.45, 1.1, 2.6), Vec3::new(0.5, 0.5, 0.6), Vec3::new(3.0, 0.9, 0.9)];
        add("lamps_recolored_night", &|g| {
            if groups[g].window {
                Vec3::new(0.05, 0.06, 0.09)
            } else {
                colors[groups[..g].iter().filter(|o| !o.window).count() % 3]
            }
        });
    }
    if windows > 0 && lamps > 0 {
        add("windows_only", &|g| {
            if groups[g].window { Vec3::splat(1.5) } else { Vec3::ZERO }
        });
    }
    if !out.is_empty()
        && let Some(room) = added::with_lamp(scene)
    {
        let (name, weights) = (added::NAME, [Vec3::ONE; MAX_GROUPS]);
        out.push(Relighting { name, weights, room: Some(room), environment: ENVIRONMENT.to_owned() });
    }
    out.extend(under_other_skies(scene));
    out
}

/// Returns the relightings of a room lit by an environment through its windows: a sun is added, or the environment is another.
fn under_other_skies(scene: &Scene) -> Vec<Relighting> {
    if scene.sky.mean() <= 0.0 {
        return Vec::new();
    }
    let brightness = scene.sky.mean();
    let mut sunny = scene.clone();
    let irradiance = 12.0 * brightness * Vec3::new(1.15, 1.0, 0.75);
    sunny.sun = Some(Sun { toward: scene.sky.sun_direction, irradiance });
    let mut turned = scene.clone();
    let Vec3 { x, y, z } = scene.sky.sun_direction;
    turned.sky.sun_direction = Vec3::new(-x, 0.6 * y, z).normalize();
    turned.sky.sun = scene.sky.sun * Vec3::new(2.5, 1.2, 0.5);
    turned.sky.zenith = 0.4 * scene.sky.zenith;
    turned.sky.horizon = scene.sky.horizon * Vec3::new(0.8, 0.5, 0.4);
    let weights = [Vec3::ONE; MAX_GROUPS];
    let set =
        |name: &'static str, room, environment: String| Relighting { name, weights, room: Some(room), environment };
    vec![
        set("sun_added", sunny, ENVIRONMENT.to_owned()),
        set(SKY_TURNED, turned, format!("environment_{SKY_TURNED}.exr")),
    ]
}

/// Returns the contents of `gt/lights.json`.
pub(crate) fn describe(scene: &Scene, relightings: &[Relighting]) -> Value {
    let under = |scene: &Scene, weights: &[Vec3; MAX_GROUPS], environment: &str| -> Vec<Value> {
        let lights = scene.lights.iter().map(|l| light(scene, l, weights[l.group], environment));
        lights.chain(scene.sun.as_ref().map(sun)).collect()
    };
    let groups = |scene: &Scene, weights: &[Vec3; MAX_GROUPS]| -> Value {
        let named = scene.groups.iter().zip(weights);
        Value::Object(named.map(|(g, w)| (g.name.clone(), json!(w.to_array()))).collect::<Map<_, _>>())
    };
    let ones = [Vec3::ONE; MAX_GROUPS];
    let mut relit = Map::new();
    let mut weights = Map::new();
    weights.insert("training".to_owned(), groups(scene, &ones));
    for r in relightings {
        let scene = r.room.as_ref().unwrap_or(scene);
        relit.insert(r.name.to_owned(), Value::Array(under(scene, &r.weights, &r.environment)));
        weights.insert(r.name.to_owned(), groups(scene, &r.weights));
    }
    json!({
        "unit": "metre",
        "note": "radiance in the linear unit of the images (exposure 1). sphere lights emit uniformly; point-light \
                 intensity equivalent I = radiance*pi*r^2 [radiance*unit^2]. rect lights emit one-sided along normal. \
                 portals show `environment`, a file in gt, times `factor`; suns shine through portals. light_groups_weights are factors on the training lighting.",
        "training": under(scene, &ones, ENVIRONMENT),
        "relight": relit,
        "light_groups_weights": weights,
    })
}

fn sun(sun: &Sun) -> Value {
    json!({
        "name": "sun",
        "on": true,
        "type": "directional_light",
        "direction": (-sun.toward).to_array(),
        "irradiance": sun.irradiance.to_array(),
        "angular_radius": 0.0,
    })
}

fn light(scene: &Scene, light: &Light, weight: Vec3, environment: &str) -> Value {
    let mut out = json!({
        "name": light.name,
        "group": scene.groups[light.group].name,
        "on": weight.max_element() > 0.0,
        "area": light.area(),
    });
    match light.emission {
        Emission::Constant(radiance) => out["radiance"] = json!((radiance * weight).to_array()),
        Emission::Sky => {
            out["environment"] = json!(environment);
            out["factor"] = json!(weight.to_array());
        }
    }
    match light.shape {
        Shape::Sphere { center, radius } => {
            out["type"] = json!("sphere_area_light");
            out["position"] = json!(center.to_array());
            out["radius"] = json!(radius);
            if let Emission::Constant(radiance) = light.emission {
                let intensity = radiance * weight * std::f32::consts::PI * radius * radius;
                out["point_light_intensity_equivalent"] = json!(intensity.to_array());
            }
        }
        Shape::Rect { corner, u, v } => {
            out["type"] = json!(match light.emission {
                Emission::Constant(_) => "rect_area_light",
                Emission::Sky => "environment_portal",
            });
            let corners = [corner, corner + u, corner + u + v, corner + v];
            out["corners"] = json!(corners.map(|c| c.to_array()));
            out["normal"] = json!(u.cross(v).normalize().to_array());
            out["position"] = json!((corner + 0.5 * (u + v)).to_array());
        }
    }
    out
}
