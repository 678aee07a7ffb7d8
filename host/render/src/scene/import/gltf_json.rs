//! The parts of a glTF 2.0 document that meshes need, as its JSON has them, and its buffers.

use std::path::{Path, PathBuf};

use base64::Engine;
use serde::Deserialize;

use lobelia_base::error::{Error, Result};

/// Extensions that a file may need: each is understood here, or has nothing to do with a mesh's shape.
const KNOWN_EXTENSIONS: [&str; 2] = ["EXT_mesh_gpu_instancing", "KHR_mesh_quantization"];
/// Prefixes of extensions of materials, lights and textures, which a scene names itself.
const PASSED_OVER: [&str; 4] = ["KHR_materials_", "KHR_texture_", "KHR_lights_", "EXT_texture_"];

/// The document.
#[derive(Debug, Default, Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub(super) struct Document {
    pub(super) asset: Asset,
    pub(super) scene: Option<usize>,
    pub(super) scenes: Vec<Scene>,
    pub(super) nodes: Vec<Node>,
    pub(super) meshes: Vec<MeshEntry>,
    pub(super) skins: Vec<Skin>,
    pub(super) accessors: Vec<Accessor>,
    pub(super) buffer_views: Vec<View>,
    pub(super) buffers: Vec<Buffer>,
    extensions_required: Vec<String>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Asset {
    pub(super) version: String,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Scene {
    pub(super) nodes: Vec<usize>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Node {
    pub(super) children: Vec<usize>,
    pub(super) mesh: Option<usize>,
    pub(super) skin: Option<usize>,
    pub(super) matrix: Option<[f64; 16]>,
    pub(super) translation: Option<[f64; 3]>,
    pub(super) rotation: Option<[f64; 4]>,
    pub(super) scale: Option<[f64; 3]>,
    pub(super) weights: Option<Vec<f64>>,
    pub(super) extensions: NodeExtensions,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct NodeExtensions {
    #[serde(rename = "EXT_mesh_gpu_instancing")]
    pub(super) instancing: Option<Instancing>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Instancing {
    pub(super) attributes: InstanceAttributes,
}

#[derive(Debug, Default, Deserialize)]
#[serde(rename_all = "UPPERCASE", default)]
pub(super) struct InstanceAttributes {
    pub(super) translation: Option<usize>,
    pub(super) rotation: Option<usize>,
    pub(super) scale: Option<usize>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct MeshEntry {
    pub(super) primitives: Vec<Primitive>,
    pub(super) weights: Option<Vec<f64>>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Primitive {
    pub(super) attributes: Attributes,
    pub(super) indices: Option<usize>,
    pub(super) mode: Option<u32>,
    pub(super) targets: Vec<Attributes>,
    pub(super) extensions: PrimitiveExtensions,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct PrimitiveExtensions {
    #[serde(rename = "KHR_draco_mesh_compression")]
    pub(super) draco: Option<serde_json::Value>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(rename_all = "UPPERCASE", default)]
pub(super) struct Attributes {
    pub(super) position: Option<usize>,
    pub(super) normal: Option<usize>,
    pub(super) texcoord_0: Option<usize>,
    pub(super) joints_0: Option<usize>,
    pub(super) weights_0: Option<usize>,
    pub(super) joints_1: Option<usize>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub(super) struct Skin {
    pub(super) inverse_bind_matrices: Option<usize>,
    pub(super) joints: Vec<usize>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub(super) struct Accessor {
    pub(super) buffer_view: Option<usize>,
    pub(super) byte_offset: usize,
    pub(super) component_type: u32,
    pub(super) normalized: bool,
    pub(super) count: usize,
    #[serde(rename = "type")]
    pub(super) dimensions: String,
    pub(super) sparse: Option<Sparse>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Sparse {
    pub(super) count: usize,
    pub(super) indices: SparsePart,
    pub(super) values: SparsePart,
}

#[derive(Debug, Default, Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub(super) struct SparsePart {
    pub(super) buffer_view: usize,
    pub(super) byte_offset: usize,
    pub(super) component_type: u32,
}

#[derive(Debug, Default, Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub(super) struct View {
    pub(super) buffer: usize,
    pub(super) byte_offset: usize,
    pub(super) byte_length: usize,
    pub(super) byte_stride: Option<usize>,
    extensions: ViewExtensions,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct ViewExtensions {
    #[serde(rename = "EXT_meshopt_compression")]
    meshopt: Option<serde_json::Value>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub(super) struct Buffer {
    uri: Option<String>,
    byte_length: usize,
}

/// Reads the document and its buffers.
///
/// # Errors
/// Input errors that name the file.
pub(super) fn read(path: &Path) -> Result<(Document, Vec<Vec<u8>>)> {
    let bytes = std::fs::read(path).map_err(|error| Error::reading(path, error))?;
    let fail = |message: String| Error::reading(path, message);
    let (json, mut blob) = chunks(&bytes).map_err(fail)?;
    let document: Document =
        serde_json::from_slice(json).map_err(|error| fail(format!("it is no glTF document: {error}")))?;
    check(&document).map_err(fail)?;
    let mut buffers = Vec::with_capacity(document.buffers.len());
    for (index, buffer) in document.buffers.iter().enumerate() {
        let mut bytes = match &buffer.uri {
            None => blob.take().ok_or_else(|| fail("its binary chunk is missing".into()))?.to_vec(),
            Some(uri) => read_uri(path, uri)?,
        };
        if bytes.len() < buffer.byte_length {
            let message = format!("buffer {index} has {} of its {} bytes", bytes.len(), buffer.byte_length);
            return Err(fail(message));
        }
        bytes.truncate(buffer.byte_length);
        buffers.push(bytes);
    }
    Ok((document, buffers))
}

/// The JSON, and the binary chunk of a .glb file.
fn chunks(bytes: &[u8]) -> std::result::Result<(&[u8], Option<&[u8]>), String> {
    if !bytes.starts_with(b"glTF") {
        return Ok((bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes), None));
    }
    let word = |at: usize| {
        let four = bytes.get(at..at + 4).and_then(|four| four.first_chunk::<4>());
        four.map(|four| u32::from_le_bytes(*four) as usize)
    };
    let short = || "its binary container is cut short".to_string();
    if word(4).ok_or_else(short)? != 2 {
        return Err("its binary container is not of version 2".into());
    }
    let mut found = [None, None];
    let mut at = 12;
    while let (Some(length), Some(kind)) = (word(at), bytes.get(at + 4..at + 8)) {
        let content = bytes.get(at + 8..).and_then(|rest| rest.get(..length)).ok_or_else(short)?;
        match kind {
            b"JSON" if at == 12 => found[0] = Some(content),
            b"BIN\0" => found[1] = found[1].or(Some(content)),
            _ => {}
        }
        at += 8 + length;
    }
    Ok((found[0].ok_or_else(short)?, found[1]))
}

/// Refuses what would be read wrongly, by its name.
fn check(document: &Document) -> std::result::Result<(), String> {
    if !document.asset.version.starts_with("2.") {
        return Err(format!("its version is \"{}\"; only glTF 2 is read", document.asset.version));
    }
    let compressed = |name: &str| format!("its meshes are compressed by {name}; export it uncompressed");
    let mut primitives = document.meshes.iter().flat_map(|mesh| &mesh.primitives);
    if primitives.any(|primitive| primitive.extensions.draco.is_some()) {
        return Err(compressed("KHR_draco_mesh_compression"));
    }
    if document.buffer_views.iter().any(|view| view.extensions.meshopt.is_some()) {
        return Err(compressed("EXT_meshopt_compression"));
    }
    let known = |name: &str| {
        KNOWN_EXTENSIONS.contains(&name) || PASSED_OVER.iter().any(|prefix| name.starts_with(prefix))
    };
    match document.extensions_required.iter().find(|name| !known(name)) {
        Some(name) => Err(format!("it needs the extension {name}, which is not read; export it without")),
        None => Ok(()),
    }
}

/// The files in which the buffers of a document lie; none of what is no document.
pub(super) fn buffer_files(path: &Path) -> Vec<PathBuf> {
    let bytes = std::fs::read(path).unwrap_or_default();
    let document = chunks(&bytes).ok().and_then(|(json, _)| serde_json::from_slice::<Document>(json).ok());
    let buffers = document.map_or_else(Vec::new, |document| document.buffers);
    let named = buffers.iter().filter_map(|buffer| buffer.uri.as_deref());
    named.filter(|uri| !uri.starts_with("data:")).map(|uri| buffer_file(path, uri)).collect()
}

/// Where a buffer lies. A name that has percent signs of its own is taken as it is where such a file is
/// there.
fn buffer_file(path: &Path, uri: &str) -> PathBuf {
    let literal = path.with_file_name(uri);
    if literal.is_file() { literal } else { path.with_file_name(percent_decoded(uri)) }
}

/// Bytes of a data URI or of a file beside the glTF file.
fn read_uri(path: &Path, uri: &str) -> Result<Vec<u8>> {
    if let Some(data) = uri.strip_prefix("data:") {
        let encoded = data.split_once(";base64,").map(|(_, encoded)| encoded);
        let encoded = encoded.ok_or_else(|| Error::reading(path, "a data URI is not in base64"))?;
        return base64::engine::general_purpose::STANDARD
            .decode(encoded)
            .map_err(|error| Error::reading(path, format!("a data URI is no base64: {error}")));
    }
    let beside = buffer_file(path, uri);
    let unreadable = |why: String| Error::reading(path, format!("its buffer {}: {why}", beside.display()));
    // A folder or a device is no buffer, and some devices never end.
    if !beside.is_file() {
        return Err(unreadable(if beside.exists() {
            "no file".into()
        } else {
            "there is no such file".into()
        }));
    }
    std::fs::read(&beside).map_err(|error| unreadable(error.to_string()))
}

/// `Box%20With%20Spaces` as `Box With Spaces`; what is no escape stays.
fn percent_decoded(uri: &str) -> String {
    let mut bytes = Vec::with_capacity(uri.len());
    let mut rest = uri.as_bytes();
    while let Some((&first, after)) = rest.split_first() {
        let hex = |digit: Option<&u8>| digit.and_then(|&digit| char::from(digit).to_digit(16));
        match (first, hex(after.first()), hex(after.get(1))) {
            (b'%', Some(high), Some(low)) => {
                bytes.push((16 * high + low) as u8);
                rest = &after[2..];
            }
            _ => {
                bytes.push(first);
                rest = after;
            }
        }
    }
    String::from_utf8_lossy(&bytes).into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percent_signs_are_decoded_and_others_stay() {
        assert_eq!(percent_decoded("Gr%C3%B6%C3%9fe%20100%.bin"), "Größe 100%.bin");
    }

    #[test]
    fn what_would_be_read_wrongly_is_refused_by_its_name() {
        let refused = |json: &str| check(&serde_json::from_str(json).unwrap()).unwrap_err();
        let asset = r#""asset":{"version":"2.0"}"#;
        assert!(refused(r#"{"asset":{"version":"1.0"}}"#).contains("version is \"1.0\""));
        let needs = format!(r#"{{{asset},"extensionsRequired":["KHR_draco_mesh_compression"]}}"#);
        assert!(refused(&needs).contains("KHR_draco_mesh_compression"));
        let draco = r#""meshes":[{"primitives":[{"extensions":{"KHR_draco_mesh_compression":{}}}]}]"#;
        assert!(refused(&format!("{{{asset},{draco}}}")).contains("export it uncompressed"));
        let meshopt = r#""bufferViews":[{"extensions":{"EXT_meshopt_compression":{}}}]"#;
        assert!(refused(&format!("{{{asset},{meshopt}}}")).contains("EXT_meshopt_compression"));
        let fine = format!(r#"{{{asset},"extensionsRequired":["KHR_materials_unlit"]}}"#);
        assert!(check(&serde_json::from_str(&fine).unwrap()).is_ok());
    }
}
