use super::*;
use base64::Engine;
use glam::{Vec2, Vec3};

use crate::scene::mesh::Vertex;

fn case(name: &str) -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/cases").join(name)
}

fn read(name: &str) -> Mesh {
    let (mesh, origin) = Mesh::read(&case(name)).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(origin, DVec3::ZERO);
    mesh
}

/// Corners of every triangle.
fn corners(mesh: &Mesh) -> Vec<[Vertex; 3]> {
    mesh.triangles.iter().map(|triangle| triangle.map(|i| mesh.vertices[i as usize])).collect()
}

/// Sums of the triangles' areas.
fn area(mesh: &Mesh) -> f32 {
    let area =
        |[a, b, c]: [Vertex; 3]| 0.5 * (b.position - a.position).cross(c.position - a.position).length();
    corners(mesh).into_iter().map(area).sum()
}

fn write(name: &str, bytes: &[u8]) -> (tempfile::TempDir, std::path::PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    std::fs::write(&path, bytes).unwrap();
    (folder, path)
}

#[test]
fn an_obj_quad_keeps_its_corners_and_its_v_is_turned_downwards() {
    let text = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nf 1/1 2/2 3/3 4/4\n";
    let (_folder, path) = write("quad.obj", text.as_bytes());
    let mesh = Mesh::read(&path).unwrap().0;
    assert_eq!((mesh.triangles.len(), mesh.vertices.len()), (2, 4));
    let origin = mesh.vertices.iter().find(|v| v.position == Vec3::ZERO).unwrap();
    assert_eq!(origin.uv, Vec2::new(0.0, 1.0));
    assert!((origin.tangent - Vec3::X).length() < 1e-6 && origin.handedness == 1.0);
}

#[test]
fn notches_stay_open() {
    // Areas by the shoelace formula: a T of 6 × 2 and 2 × 4; a square of 4 less a triangle of 2 × 1.6 / 2.
    assert!((area(&read("obj/concave-t.obj")) - 20.0).abs() < 1e-5);
    assert!((area(&read("ply/concave.ply")) - 2.4).abs() < 1e-5);
}

#[test]
fn lines_are_no_surfaces() {
    let mesh = read("obj/polyline.obj");
    assert!(mesh.triangles.len() == 1 && (area(&mesh) - 0.5).abs() < 1e-6);
}

#[test]
fn parts_with_texture_coordinates_and_normals_keep_them_beside_parts_without() {
    for (name, largest) in [("obj/mixed-uv.obj", 8.0), ("obj/mixed-in-one.obj", 1.0)] {
        let mesh = read(name);
        let textured = corners(&mesh)[..2].concat();
        let reach = textured.iter().map(|vertex| vertex.uv.x.max(1.0 - vertex.uv.y)).fold(0.0, f32::max);
        assert_eq!(reach, largest, "{name}");
        assert!((textured[0].uv - Vec2::new(0.0, 1.0)).length() < 1e-6, "{name}");
        assert!(corners(&mesh)[2..].concat().iter().all(|vertex| vertex.uv.is_finite()));
    }
    // Of two boxes the first has texture coordinates 0..1 on every side; projected ones of the two would
    // be 0.4 wide.
    let boxes = corners(&read("gltf/mixeduv.gltf"));
    assert_eq!(boxes.len(), 24);
    let along = |uv: fn(&Vertex) -> f32| {
        let uvs: Vec<f32> = boxes[..12].concat().iter().map(uv).collect();
        uvs.iter().copied().fold(f32::MIN, f32::max) - uvs.iter().copied().fold(f32::MAX, f32::min)
    };
    assert!(along(|v| v.uv.x) > 0.9 && along(|v| v.uv.y) > 0.9);
}

/// Editors put U+FEFF in front; the first line is the file's as any other.
#[test]
fn a_byte_order_mark_costs_an_obj_no_line() {
    let text = "v 0 0 0\nv 3 0 0\nv 0 2 0\nv 9 9 9\nf 1 2 3\n";
    let (_folder, path) = write("marked.obj", format!("\u{feff}{text}").as_bytes());
    assert!((area(&Mesh::read(&path).unwrap().0) - 3.0).abs() < 1e-6);
}

#[test]
fn odd_but_sound_files_are_read() {
    for name in ["obj/usemtl-empty.obj", "obj/latin1.obj", "ply/latin1comment.ply", "ply/ascii-blank.ply"] {
        let mesh = read(name);
        assert!(mesh.triangles.len() == 2 && (area(&mesh) - 4.0).abs() < 1e-6, "{name}");
    }
    // Numbers of 16 bits: a square of 200, not a point.
    assert!((area(&read("ply/short.ply")) - 40_000.0).abs() < 0.1);
}

#[test]
fn a_ply_file_s_texture_coordinates_by_face_are_used() {
    let mesh = read("ply/wedge.ply");
    // The file's are those of the corner (x, y): x + 1 and y + 1, v upwards.
    for vertex in &mesh.vertices {
        let [x, y, _] = vertex.position.to_array();
        assert_eq!(vertex.uv, Vec2::new(x + 1.0, -y), "{vertex:?}");
    }
}

#[test]
fn strips_and_fans_are_triangles_that_all_face_one_way_and_flat_without_normals() {
    let mesh = read("gltf/modes.gltf");
    assert!(mesh.triangles.len() == 6 && (area(&mesh) - 3.0).abs() < 1e-5);
    for [a, b, c] in corners(&mesh) {
        let face = (b.position - a.position).cross(c.position - a.position).normalize();
        assert!((face - Vec3::Z).length() < 1e-5 && (a.normal - face).length() < 1e-5, "{face}");
    }
    assert_eq!(read("gltf/striponly.gltf").triangles.len(), 2);
    // A bent pair of triangles: each has its own normal where they meet.
    let bent = gltf_triangles(
        &[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 1.0, 0.0, 1.0, 0.0],
        "",
    );
    let (_folder, path) = write("bent.gltf", bent.as_bytes());
    for [a, b, c] in corners(&Mesh::read(&path).unwrap().0) {
        let face = (b.position - a.position).cross(c.position - a.position).normalize();
        assert!([a, b, c].iter().all(|vertex| (vertex.normal - face).length() < 1e-5));
    }
}

#[test]
fn a_percent_sign_in_a_buffer_s_name_is_decoded() {
    assert_eq!(read("gltf/percent.gltf").triangles.len(), 12);
}

#[test]
fn instances_stand_one_by_one() {
    let mesh = read("gltf/instancing.gltf");
    assert_eq!(mesh.triangles.len(), 36);
    assert!((area(&mesh) - 3.0 * 24.0).abs() < 1e-3);
    let (low, high) = mesh.bounds();
    assert!((high - low).max_element() > 3.0, "the instances stand apart: {low} {high}");
}

#[test]
fn a_skinned_mesh_stands_where_its_joints_are_and_not_where_its_node_is() {
    // The node would make it 200 wide about x = 50.
    let (low, high) = read("gltf/skin.gltf").bounds();
    assert!((high - low - Vec3::splat(2.0)).length() < 1e-5 && low.x.abs() < 2.0, "{low} {high}");
}

/// A document of triangles with these positions; `more` goes into the node.
fn gltf_triangles(positions: &[f32], more: &str) -> String {
    let bytes: Vec<u8> = positions.iter().flat_map(|x| x.to_le_bytes()).collect();
    let data = base64::engine::general_purpose::STANDARD.encode(&bytes);
    let (count, length) = (positions.len() / 3, bytes.len());
    format!(
        r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],
        "nodes":[{{"mesh":0{more}}}],
        "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}},"targets":[{{"POSITION":0}}]}}]}}],
        "accessors":[{{"bufferView":0,"componentType":5126,"count":{count},"type":"VEC3","min":[0,0,0],
        "max":[1,1,1]}}],
        "bufferViews":[{{"buffer":0,"byteLength":{length}}}],
        "buffers":[{{"byteLength":{length},"uri":"data:application/octet-stream;base64,{data}"}}]}}"#
    )
}

const TRIANGLE: [f32; 9] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0];

#[test]
fn a_gltf_triangle_is_moved_by_its_node_and_by_the_weights_of_its_targets() {
    let (_folder, path) =
        write("triangle.gltf", gltf_triangles(&TRIANGLE, r#","translation":[5,0,0]"#).as_bytes());
    let mesh = Mesh::read(&path).unwrap().0;
    assert_eq!(mesh.vertices[0].position, Vec3::new(5.0, 0.0, 0.0));
    assert!((mesh.vertices[0].normal - Vec3::Z).length() < 1e-6);
    // The target is the triangle itself: a weight of 2 makes it three times as large.
    let (_folder, path) = write("morph.gltf", gltf_triangles(&TRIANGLE, r#","weights":[2]"#).as_bytes());
    assert!((area(&Mesh::read(&path).unwrap().0) - 4.5).abs() < 1e-6);
}

#[test]
fn nodes_that_share_a_child_or_form_a_loop_are_refused() {
    for (nodes, part) in [
        (
            r#"[{"mesh":0,"children":[1,2]},{"children":[3]},{"children":[3]},{}]"#,
            "node 3 is a child of nodes 1 and 2",
        ),
        (r#"[{"mesh":0},{"children":[2]},{"children":[1]}]"#, "loop through node 1"),
        (r#"[{"mesh":0,"children":[7]}]"#, "node 0 has no child 7"),
    ] {
        let text = gltf_triangles(&TRIANGLE, "").replace(r#"[{"mesh":0}]"#, nodes);
        let (_folder, path) = write("nodes.gltf", text.as_bytes());
        let error = Mesh::read(&path).unwrap_err();
        assert!(error.exit_code() == 2 && error.to_string().contains(part), "{error}");
    }
}

#[test]
fn broken_files_are_refused_by_name_in_one_sentence() {
    for (name, bytes) in [
        ("a.obj", &b"v 0 0\nf 1 2 3\n"[..]),
        ("b.ply", b"ply\nformat ascii 1.0\nelement vertex 3\n"),
        ("c.gltf", b"{}"),
        ("d.glb", b"glTF"),
        ("e.stl", b"solid"),
        ("f.obj", b""),
        ("g.gltf", b"{\"asset\":{\"version\":\"2.0\"},\n\"nodes\":3}"),
    ] {
        let (_folder, path) = write(name, bytes);
        let error = Mesh::read(&path).unwrap_err();
        let text = error.to_string();
        assert!(error.exit_code() == 2 && text.matches(name).count() == 1 && !text.contains('\n'), "{text}");
    }
    for (name, part) in
        [("gltf/stride8.gltf", "byteStride is 8"), ("ply/xyz-missing-z.ply", "vertices need x, y and z")]
    {
        let error = Mesh::read(&case(name)).unwrap_err();
        assert!(error.exit_code() == 2 && error.to_string().contains(part), "{error}");
    }
}
