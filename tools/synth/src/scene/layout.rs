//! Furnishing of a room: items, positions and colors.
//!
//! Every room has a seating group around a rug in the middle, a low cabinet under the windows, a bookcase and a dining
//! corner. The seed mirrors, resizes, recolors and rearranges them. Cameras stand in the southern half, which holds
//! nothing tall.

use std::f32::consts::{FRAC_PI_2, TAU};

use glam::{Affine3A, Quat, Vec2, Vec3};

use crate::rng::Rng;
use crate::scene::builder::Builder;
use crate::scene::furniture::{decor, lamps, plants, seats, shelves, tables, textiles, walls};
use crate::scene::material::Material;
use crate::scene::room::{self, Hole, Side, Size};
use crate::scene::sky::Sky;
use crate::scene::style::{Style, Windows};
use crate::scene::texture::Texture;
use crate::scene::theme::Theme;
use crate::scene::{Bounds, Scene};

/// Materials shared between items.
struct Shared {
    wood: u16,
    metal: u16,
    border: u16,
    pad: u16,
}

/// Builds a furnished room.
pub(crate) fn build(style: Style, seed: u64) -> Scene {
    let mut rng = Rng::new(&[seed, 0x0400]);
    let rng = &mut rng;
    let theme = Theme::choose(rng);
    let size = Size { hx: rng.range(2.65, 3.1), hz: rng.range(2.35, 2.75), height: rng.range(2.5, 2.75) };
    // +1, or −1 to mirror the room in x.
    let flip = if rng.chance(0.5) { 1.0 } else { -1.0 };
    let (sofa_side, case_side) = if flip > 0.0 { (Side::West, Side::East) } else { (Side::East, Side::West) };
    let holes = holes(&style, size, rng);
    let papered = if rng.chance(0.6) { sofa_side } else { Side::North };
    let mut b = Builder::new();
    room::shell(&mut b, size, &theme, &style, papered, &holes, rng);
    let shared = materials(&mut b, &theme, &style, rng);
    let at = |x: f32, z: f32, yaw: f32| {
        Affine3A::from_rotation_translation(Quat::from_rotation_y(flip * yaw), Vec3::new(flip * x, 0.0, z))
    };
    seating(&mut b, &at, size, &theme, &style, &shared, rng);
    let setting = Setting { size, theme: &theme, style: &style, shared: &shared };
    north(&mut b, &setting, &holes, flip, rng);
    dining(&mut b, &at, size, &theme, &shared, rng);
    // The bookcase stands in the northern half of the wall opposite the sofa.
    let width = rng.range(1.0, 1.3);
    let along = |side: Side, z: f32| if side == Side::West { -z } else { z };
    let case = along(case_side, -size.hz + 0.25 + 0.5 * width);
    let height = rng.range(1.75, 2.05);
    shelves::bookcase(
        &mut b,
        size.wall(case_side) * Affine3A::from_translation(Vec3::new(case, 0.0, 0.02)),
        [width, height],
        &theme,
        [shared.wood, shared.metal],
        rng,
    );
    pictures(&mut b, &setting, [sofa_side, case_side], rng);
    if style.specular == 0.0 {
        b.without_specular();
    }
    let interior = Bounds { min: Vec3::new(-size.hx, 0.0, -size.hz), max: Vec3::new(size.hx, size.height, size.hz) };
    let sky = if style.windows == Windows::Open {
        let height = rng.range(0.25, 0.5);
        Sky {
            zenith: Vec3::new(0.9, 1.5, 2.7),
            horizon: Vec3::new(2.6, 2.8, 3.0),
            ground: Vec3::new(0.55, 0.6, 0.42),
            sun: Vec3::new(7.0, 5.4, 3.6),
            sun_direction: Vec3::new(0.5 * flip, height, -0.8).normalize(),
        }
    } else {
        Sky::DARK
    };
    b.finish(interior, Vec3::new(0.0, 0.7, -0.35), sky)
}

fn holes(style: &Style, size: Size, rng: &mut Rng) -> Vec<Hole> {
    if style.windows == Windows::None {
        return Vec::new();
    }
    let large = style.windows == Windows::Open;
    let width = if large { rng.range(1.5, 1.7) } else { rng.range(1.05, 1.3) };
    let sill = rng.range(0.85, 0.95);
    let height = (size.height - 0.32 - sill).min(if large { 1.5 } else { 1.3 });
    let apart = rng.range(0.5, 0.58) * size.hx;
    [-apart, apart].map(|x| Hole { x, sill, width, height }).to_vec()
}

fn materials(b: &mut Builder, theme: &Theme, style: &Style, rng: &mut Rng) -> Shared {
    let seed = rng.next_u32();
    let wood = b.material(
        Material::new(Texture::Wood { light: theme.wood[0], dark: theme.wood[1], seed }, rng.range(0.3, 0.5))
            .varied(0.06),
    );
    let metal = b.material(Material::metal(theme.metal, if style.polished { 0.08 } else { rng.range(0.2, 0.32) }));
    let border =
        if rng.chance(0.5) { wood } else { b.material(Material::new(Texture::Solid(Vec3::splat(0.035)), 0.35)) };
    let seed = rng.next_u32();
    let pad = b.material(Material::new(
        Texture::Weave { light: theme.accents[0], dark: theme.accents[0] * 0.7, size: 0.06, seed },
        0.9,
    ));
    Shared { wood, metal, border, pad }
}

/// Adds sofa, armchair, rug, coffee table, floor lamp and pendant.
fn seating(
    b: &mut Builder,
    at: &dyn Fn(f32, f32, f32) -> Affine3A,
    size: Size,
    theme: &Theme,
    style: &Style,
    shared: &Shared,
    rng: &mut Rng,
) {
    let center = Vec2::new(rng.range(-0.35, -0.1), rng.range(-0.35, -0.1));
    let half = Vec2::new(rng.range(1.2, 1.45), rng.range(0.85, 1.05));
    textiles::rug(b, at(center.x, center.y, 0.0), half, theme, rng);
    let sofa_x = -size.hx + 0.55;
    let places = if size.hz > 2.5 { 3 } else { 2 };
    let mut cushions = theme.accents.to_vec();
    cushions.truncate(places);
    let upholstery = seats::Upholstery { places, cloth: theme.sofa, wood: shared.wood, cushions: &cushions };
    seats::sofa(b, "sofa", at(sofa_x, center.y, FRAC_PI_2), &upholstery, rng);
    tables::coffee_table(
        b,
        at(center.x, center.y, FRAC_PI_2 + rng.range(-0.1, 0.1)),
        theme,
        shared.wood,
        shared.metal,
        rng,
    );
    let (x, z) = (center.x + rng.range(1.3, 1.5), center.y - rng.range(0.0, 0.45));
    let yaw = (center.x - x).atan2(center.y - z) + rng.range(-0.2, 0.2);
    let cushions = &theme.accents[1..2];
    let upholstery = seats::Upholstery { places: 1, cloth: theme.armchair, wood: shared.wood, cushions };
    seats::sofa(b, "armchair", at(x, z, yaw), &upholstery, rng);
    lamps::floor_lamp(b, at(-size.hx + 0.38, -size.hz + 0.42, 0.0), shared.metal, style.lamps[0]);
    let drop = size.height - rng.range(1.95, 2.05);
    lamps::pendant(
        b,
        at(center.x, center.y, 0.0) * Affine3A::from_translation(Vec3::Y * size.height),
        drop,
        shared.metal,
        style.lamps[1],
    );
}

/// Furnishes the window wall: curtains, sideboard with small objects, plant.
fn north(b: &mut Builder, room: &Setting<'_>, holes: &[Hole], flip: f32, rng: &mut Rng) {
    let &Setting { size, theme, style, shared } = room;
    let wall = size.wall(Side::North);
    for hole in holes {
        let middle = Vec3::new(hole.x, hole.sill + 0.5 * hole.height, 0.0);
        textiles::curtains(
            b,
            wall * Affine3A::from_translation(middle),
            Vec2::new(hole.width, hole.height),
            middle.y,
            [theme.accents[3], theme.accents[3] * 0.75],
            shared.metal,
            rng,
        );
    }
    let width = rng.range(1.5, 1.8);
    let x = flip * rng.range(-0.35, 0.05);
    let foot = wall * Affine3A::from_translation(Vec3::new(x, 0.0, 0.40));
    let top = tables::sideboard(b, foot, width, theme, shared.wood, shared.metal, rng);
    let on = |dx: f32, dz: f32| foot * Affine3A::from_translation(Vec3::new(dx * flip, top, dz));
    lamps::table_lamp(b, on(0.5 * width - 0.2, 0.0), theme.accents[1], shared.metal, style.lamps[2]);
    plants::potted(b, "small_plant", on(0.2 - 0.5 * width, 0.0), 0.42, theme.accents[0], rng);
    decor::vase(b, "tall_vase", on(-0.22, -0.02), theme.accents[3], 1.25, false, rng);
    decor::book_stack(b, on(0.12, 0.02), theme, 3, rng);
    let corner = Vec3::new(flip * (size.hx - 1.0), 0.0, -size.hz + 0.55);
    plants::potted(b, "large_plant", Affine3A::from_translation(corner), rng.range(0.95, 1.2), theme.accents[2], rng);
    b.obstacle();
}

/// Adds the round table with chairs in the southern corner.
fn dining(
    b: &mut Builder,
    at: &dyn Fn(f32, f32, f32) -> Affine3A,
    size: Size,
    theme: &Theme,
    shared: &Shared,
    rng: &mut Rng,
) {
    let (x, z) = (size.hx - rng.range(1.0, 1.15), size.hz - rng.range(1.15, 1.3));
    tables::dining_table(b, at(x, z, 0.0), theme, shared.wood, shared.metal, rng);
    let legs = if rng.chance(0.5) { shared.metal } else { shared.wood };
    let start = rng.range(0.0, TAU);
    for i in 0..3 {
        let angle = start + TAU * i as f32 / 3.0 + rng.range(-0.2, 0.2);
        let out = Vec2::new(angle.sin(), angle.cos()) * rng.range(0.62, 0.72);
        // A chair faces the table.
        seats::chair(b, at(x + out.x, z + out.y, angle + TAU * 0.5), shared.wood, legs, shared.pad);
    }
}

/// Size and looks of a room.
struct Setting<'a> {
    size: Size,
    theme: &'a Theme,
    style: &'a Style,
    shared: &'a Shared,
}

/// Hangs pictures and a mirror on the walls of the sofa and of the bookcase.
fn pictures(b: &mut Builder, room: &Setting<'_>, [sofa_side, case_side]: [Side; 2], rng: &mut Rng) {
    let &Setting { size, theme, style, shared } = room;
    let hang = |b: &mut Builder, side: Side, x: f32, y: f32, half: Vec2, rng: &mut Rng| {
        let frame = size.wall(side) * Affine3A::from_translation(Vec3::new(x, y, 0.0));
        walls::picture(b, frame, half, theme, shared.border, rng);
    };
    let toward = |side: Side, z: f32| if side == Side::West { -z } else { z };
    if style.polished {
        let frame = size.wall(sofa_side) * Affine3A::from_translation(Vec3::new(toward(sofa_side, -0.2), 1.55, 0.0));
        walls::mirror(b, frame, Vec2::new(0.75, 0.5), shared.border);
    } else {
        let count = 2 + rng.index(2);
        for i in 0..count {
            let z = -0.2 + (i as f32 - 0.5 * (count - 1) as f32) * 0.85;
            let half = Vec2::new(rng.range(0.26, 0.36), rng.range(0.28, 0.42));
            hang(b, sofa_side, toward(sofa_side, z), rng.range(1.5, 1.62), half, rng);
        }
    }
    let z = rng.range(0.3, 0.9);
    let half = Vec2::new(rng.range(0.45, 0.6), rng.range(0.36, 0.48));
    hang(b, case_side, toward(case_side, z), 1.55, half, rng);
    for x in [-0.55, 0.55] {
        let half = Vec2::new(rng.range(0.32, 0.46), rng.range(0.4, 0.5));
        hang(b, Side::South, x * size.hx, 1.55, half, rng);
    }
    if style.windows == Windows::None {
        for x in [-0.5, 0.5] {
            let half = Vec2::new(rng.range(0.45, 0.6), rng.range(0.4, 0.5));
            hang(b, Side::North, x * size.hx, 1.5, half, rng);
        }
    }
}
