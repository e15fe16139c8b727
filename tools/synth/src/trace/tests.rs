//! Tests of the integrator: furnace energy, two estimators of the same light, a closed form.

use glam::{Affine3A, Vec3};

use crate::options::SceneName;
use crate::scene::builder::Builder;
use crate::scene::light::{Emission, Shape};
use crate::scene::material::Material;
use crate::scene::sky::Sky;
use crate::scene::texture::Texture;
use crate::scene::{Bounds, Scene};
use crate::trace::path::{PathOptions, PathSample, trace};
use crate::trace::sampler::Sampler;

const UNBIASED: PathOptions = PathOptions { bounces: 5, next_event: true, clamp: f32::INFINITY };

fn close(b: Builder) -> Scene {
    let bounds = Bounds { min: Vec3::splat(-5.0), max: Vec3::splat(5.0) };
    b.finish(bounds, Vec3::ZERO, Sky::DARK)
}

fn plain(albedo: f32, roughness: f32, metallic: f32, specular: f32) -> Material {
    Material { metallic, specular, ..Material::new(Texture::Solid(Vec3::splat(albedo)), roughness) }
}

fn total(sample: &PathSample) -> Vec3 {
    let groups = sample.diffuse.iter().chain(&sample.specular);
    groups.copied().sum()
}

/// Returns the mean and the standard error of the red channel of `n` paths.
fn estimate(scene: &Scene, from: Vec3, to: Vec3, options: &PathOptions, n: u32) -> (f32, f32) {
    let direction = (to - from).normalize();
    let (mut sum, mut squares) = (0.0f64, 0.0f64);
    for index in 0..n {
        // Every path gets its own key, because the standard error assumes independent samples.
        let mut sampler = Sampler::new(crate::rng::key(&[u64::from(index)]), 0);
        let (_, path) = trace(scene, from, direction, &mut sampler, options);
        let value = f64::from(total(&path).x);
        sum += value;
        squares += value * value;
    }
    let mean = sum / f64::from(n);
    let variance = (squares / f64::from(n) - mean * mean).max(0.0) / f64::from(n);
    (mean as f32, variance.sqrt() as f32)
}

/// Returns the brightness of a ball in a uniform environment of radiance 1.
fn furnace(material: Material) -> f32 {
    let mut b = Builder::new();
    b.object("ball", "ornament", Affine3A::IDENTITY);
    b.material(material);
    b.ball(Vec3::ZERO, 1.0);
    let mut scene = close(b);
    scene.background = Vec3::ONE;
    estimate(&scene, Vec3::Z * 4.0, Vec3::new(0.3, 0.2, 0.9), &UNBIASED, 4000).0
}

#[test]
fn diffuse_ball_in_a_furnace_has_its_albedo() {
    let seen = furnace(plain(0.8, 1.0, 0.0, 0.0));
    assert!((seen - 0.8).abs() < 5e-3, "{seen}");
}

#[test]
fn materials_in_a_furnace_conserve_energy() {
    for roughness in [0.1, 0.4, 0.8] {
        let metal = furnace(plain(0.9, roughness, 1.0, 1.0));
        let paint = furnace(plain(0.5, roughness, 0.0, 1.0));
        assert!(metal > 0.45 && metal < 0.91, "roughness {roughness}: {metal}");
        assert!(paint > 0.5 && paint < 0.6, "roughness {roughness}: {paint}");
    }
}

/// Builds a floor, a wall and two lights of different shapes.
fn corner(roughness: f32, metallic: f32) -> Scene {
    let mut b = Builder::new();
    b.object("floor", "floor", Affine3A::IDENTITY);
    b.material(plain(0.7, roughness, metallic, 1.0));
    b.quad(Vec3::new(-2.0, 0.0, 2.0), Vec3::X * 4.0, Vec3::NEG_Z * 4.0);
    b.quad(Vec3::new(-2.0, 0.0, -2.0), Vec3::X * 4.0, Vec3::Y * 4.0);
    let first = b.group("panel", true);
    let second = b.group("ball", false);
    b.light(
        "panel",
        first,
        Shape::Rect { corner: Vec3::new(-1.0, 2.0, -1.0), u: Vec3::X * 1.5, v: Vec3::Z * 1.5 },
        Emission::Constant(Vec3::splat(2.0)),
    );
    b.light(
        "ball",
        second,
        Shape::Sphere { center: Vec3::new(1.2, 0.8, 0.2), radius: 0.4 },
        Emission::Constant(Vec3::splat(3.0)),
    );
    close(b)
}

#[test]
fn light_sampling_matches_brdf_sampling() {
    for (roughness, metallic) in [(0.9, 0.0), (0.3, 0.0), (0.3, 1.0)] {
        let scene = corner(roughness, metallic);
        let (from, to) = (Vec3::new(0.3, 1.5, 3.0), Vec3::new(0.2, 0.0, 0.1));
        let blind = PathOptions { next_event: false, ..UNBIASED };
        let (a, ea) = estimate(&scene, from, to, &UNBIASED, 40_000);
        let (b, eb) = estimate(&scene, from, to, &blind, 40_000);
        let error = (ea * ea + eb * eb).sqrt();
        assert!(ea < 1.1 * eb, "light sampling does no harm: {ea} {eb}");
        assert!((a - b).abs() < 3.5 * error, "{roughness} {metallic}: {a} {b} ± {error}");
    }
}

#[test]
fn sphere_light_over_diffuse_floor_matches_closed_form() {
    let (height, radius, radiance, albedo) = (1.5f32, 0.25f32, 8.0f32, 0.6f32);
    let mut b = Builder::new();
    b.object("floor", "floor", Affine3A::IDENTITY);
    b.material(plain(albedo, 1.0, 0.0, 0.0));
    b.quad(Vec3::new(-9.0, 0.0, 9.0), Vec3::X * 18.0, Vec3::NEG_Z * 18.0);
    let group = b.group("ball", false);
    let center = Vec3::Y * height;
    b.light("ball", group, Shape::Sphere { center, radius }, Emission::Constant(Vec3::splat(radiance)));
    let scene = close(b);
    let seen = estimate(&scene, Vec3::new(0.0, 0.5, 3.0), Vec3::ZERO, &UNBIASED, 3000).0;
    // Irradiance below the center of a sphere is π L (r/h)².
    let truth = albedo * radiance * (radius / height).powi(2);
    assert!((seen - truth).abs() < 0.01 * truth, "{seen} {truth}");
}

#[test]
fn light_groups_are_separable() {
    let scene = corner(0.5, 0.0);
    let mut dark = corner(0.5, 0.0);
    dark.lights[1].emission = Emission::Constant(Vec3::ZERO);
    let direction = (Vec3::new(0.2, 0.0, 0.1) - Vec3::new(0.3, 1.5, 3.0)).normalize();
    let (mut both, mut one) = (Vec3::ZERO, Vec3::ZERO);
    for index in 0..20_000 {
        let from = Vec3::new(0.3, 1.5, 3.0);
        let (_, a) = trace(&scene, from, direction, &mut Sampler::new(7, index), &UNBIASED);
        let (_, b) = trace(&dark, from, direction, &mut Sampler::new(7, index), &UNBIASED);
        both += a.diffuse[0] + a.specular[0];
        one += total(&b);
    }
    assert!((both.x - one.x).abs() < 0.03 * one.x, "{both} {one}");
}

#[test]
fn no_ray_escapes_a_closed_room() {
    let scene = Scene::build(SceneName::LivingRoom, 3);
    for index in 0..2000u32 {
        let mut rng = crate::rng::Rng::new(&[u64::from(index)]);
        let direction = rng.normal3().normalize();
        assert!(scene.hit(scene.focus + Vec3::Y * 0.9, direction).is_some(), "the room has a hole towards {direction}");
    }
}

#[test]
fn denoising_raises_psnr_and_normals_are_unit() {
    use crate::trace::denoise;
    use crate::trace::render::render;
    use crate::views;
    let mut scene = Scene::build(SceneName::Box, 2);
    let options = crate::options::SynthOptions { views: 1, width: 64, height: 48, ..Default::default() };
    let camera = views::place(&scene, &options).train[0];
    crate::expose::expose(&mut scene, &[camera], 2);
    let ones = [Vec3::ONE; crate::scene::MAX_GROUPS];
    let picture = |key: u64, samples: usize, clean: bool| {
        let film = render(&scene, &camera, key, samples, &PathOptions::default(), &|| {});
        for f in &film.features {
            assert!((f.normal.length() - 1.0).abs() < 1e-4);
            assert!(!f.surface || f.normal.dot(camera.position - f.position) > 0.0);
        }
        denoise::image(&film, 1.0 / camera.focal, &ones, clean)
    };
    // A different key, so that the reference shares no samples with the tested images.
    let truth = picture(1, 256, false);
    let psnr = |image: &[Vec3]| {
        let pairs = image.iter().zip(&truth);
        let squares: f32 =
            pairs.map(|(a, b)| (crate::color::encode3(*a) - crate::color::encode3(*b)).length_squared()).sum();
        -10.0 * (squares / (3 * image.len()) as f32).log10()
    };
    let (raw, clean) = (psnr(&picture(2, 32, false)), psnr(&picture(2, 32, true)));
    assert!(clean > raw + 3.0 && clean > 34.0, "raw {raw} dB, denoised {clean} dB");
}
