//! What Rust writes is where WGSL reads it: sizes and offsets of every shared structure, as naga lays out the
//! shader's own.

use std::mem::offset_of;

use wgpu::naga::TypeInner;
use wgpu::naga::front::wgsl;

use crate::{environment, fit, lights};

/// Size, and name and offset of every member, of a structure of a shader.
fn laid_out(source: &str, name: &str) -> (usize, Vec<(String, usize)>) {
    let module = wgsl::parse_str(source).unwrap_or_else(|error| panic!("{}", error.emit_to_string(source)));
    let (_, found) = module.types.iter().find(|(_, found)| found.name.as_deref() == Some(name)).unwrap();
    let TypeInner::Struct { members, span } = &found.inner else { panic!("{name} is no structure") };
    let members = members.iter().map(|member| (member.name.clone().unwrap(), member.offset as usize));
    (*span as usize, members.collect())
}

/// Compares a structure with that of a shader, member by member; a member that Rust has by another name comes
/// with its offset.
macro_rules! same {
    ($source:expr, $name:literal, $of:ty, $($member:ident $(= $offset:expr)?),+) => {
        let expected = vec![$((stringify!($member).to_string(), same!(@ $of, $member $(, $offset)?))),+];
        assert_eq!(laid_out($source, $name), (size_of::<$of>(), expected), $name);
    };
    (@ $of:ty, $member:ident) => { offset_of!($of, $member) };
    (@ $of:ty, $member:ident, $offset:expr) => { $offset };
}

#[test]
fn the_fit_s_structures_are_laid_out_as_its_shader_reads_them() {
    let constants = ["LOBES", "SLOTS", "FAMILY", "DERIVATIVES", "FORMS", "UNKNOWNS", "MOST"];
    let constants: String = constants.iter().map(|name| format!("const {name} = 2u;\n")).collect();
    let shader = &(constants + fit::SHADER);
    same!(shader, "Job", fit::Job, poses, channels, diffuse, iterations, tolerance, lobes, unknowns, first);
    same!(shader, "Texel", fit::Texel, most, cone);
    same!(shader, "Fit", fit::Fit, texel, beta, cost, unused, lobes, x);
}

#[test]
fn a_scene_s_structures_are_laid_out_as_the_shader_of_lights_reads_them() {
    let shader = &format!("{}{}", lights::SHADER, lights::NOT_DISTANT);
    same!(shader, "View", lights::View, projection, eye, offset);
    let edges = offset_of!(lights::Lamp, edges);
    same!(shader, "Lamp", lights::Lamp, place, power, u = edges, v = edges + size_of::<glam::Vec4>());
    same!(
        shader,
        "Material",
        lights::Material,
        first,
        width,
        height,
        bilinear,
        tiling,
        levels,
        brightest,
        emission,
        emits,
        mask,
        lobes,
        coats
    );
    same!(shader, "Node", lights::Node, low, first, high, count);
    same!(shader, "Leaf", lights::Leaf, corner, triangle, e1, object, e2);
}

#[test]
fn an_environment_s_structures_are_laid_out_as_its_shaders_read_them() {
    let shader = &format!("{}{}", lights::SHADER, environment::SHADER);
    same!(shader, "Sky", environment::Sky, turn, maps, horizon, harmonics, coefficients);
    same!(shader, "Map", environment::Map, n, first, width, height);
    same!(environment::PREFILTER, "Task", environment::Task, source, map, n, least_cosine, reach, first);
}
