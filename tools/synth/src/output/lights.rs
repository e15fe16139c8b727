//! Ground-truth lights and the relightings of the test views.

use glam::Vec3;
use serde_json::{Map, Value, json};

use crate::scene::light::{Emission, Light, Shape};
use crate::scene::{MAX_GROUPS, Scene, added};

/// Lighting that differs from training: a factor for each light group, and perhaps one more light.
pub(crate) struct Relighting {
    /// Name of the folder under `gt/relit`.
    pub(crate) name: &'static str,
    /// Factors by group.
    pub(crate) weights: [Vec3; MAX_GROUPS],
    /// Scene with a light that training lacks, its last.
    pub(crate) room: Option<Scene>,
}

/// Returns the relightings of a scene. A scene with a single group of lights has none.
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
        out.push(Relighting { name, weights, room: None });
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
        out.push(Relighting { name: added::NAME, weights: [Vec3::ONE; MAX_GROUPS], room: Some(room) });
    }
    out
}

/// Returns the contents of `gt/lights.json`.
pub(crate) fn describe(scene: &Scene, relightings: &[Relighting]) -> Value {
    let under = |scene: &Scene, weights: &[Vec3; MAX_GROUPS]| -> Vec<Value> {
        let lights = scene.lights.iter();
        lights.map(|l| light(scene, l, weights[l.group])).collect()
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
        relit.insert(r.name.to_owned(), Value::Array(under(scene, &r.weights)));
        weights.insert(r.name.to_owned(), groups(scene, &r.weights));
    }
    json!({
        "unit": "metre",
        "note": "radiance in the linear unit of the images (exposure 1). sphere lights emit uniformly; point-light \
                 intensity equivalent I = radiance*pi*r^2 [radiance*unit^2]. rect lights emit one-sided along normal. \
                 portals show gt/environment.exr. light_groups_weights are factors on the training lighting.",
        "training": under(scene, &ones),
        "relight": relit,
        "light_groups_weights": weights,
    })
}

fn light(scene: &Scene, light: &Light, weight: Vec3) -> Value {
    let mut out = json!({
        "name": light.name,
        "group": scene.groups[light.group].name,
        "on": weight.max_element() > 0.0,
        "area": light.area(),
    });
    if let Emission::Constant(radiance) = light.emission {
        out["radiance"] = json!((radiance * weight).to_array());
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
