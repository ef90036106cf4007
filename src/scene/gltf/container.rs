//! The file around the scene: GLB chunks and the JSON document.

use gltf::json::{Root, Value, deserialize};

/// A file's JSON and its GLB binary chunk. A .gltf file is all JSON; the two are told apart by GLB's magic number.
pub(super) fn split(bytes: &[u8]) -> Result<(&[u8], Option<&[u8]>), String> {
    if !bytes.starts_with(b"glTF") {
        return Ok((bytes, None));
    }
    let word = |at: usize| bytes.get(at..at + 4).map(|w| u32::from_le_bytes([w[0], w[1], w[2], w[3]]));
    let (Some(version), Some(length)) = (word(4), word(8)) else {
        return Err("the GLB header is cut off; export or download it again".to_owned());
    };
    if version != 2 {
        return Err(format!("GLB version {version}; export as glTF 2.0"));
    }
    let length = length as usize;
    if length > bytes.len() || length < 12 {
        return Err(format!(
            "the GLB header says {length} bytes but the file has {}; export or download it again",
            bytes.len()
        ));
    }
    let mut json = None;
    let mut binary = None;
    let mut at = 12;
    while at + 8 <= length {
        let (Some(size), Some(kind)) = (word(at), bytes.get(at + 4..at + 8)) else { break };
        let start = at + 8;
        let Some(chunk) = start.checked_add(size as usize).filter(|&end| end <= length).map(|end| &bytes[start..end])
        else {
            return Err(format!("GLB chunk at byte {at} runs past the end of the file; export or download it again"));
        };
        match kind {
            b"JSON" if json.is_none() => json = Some(chunk),
            b"BIN\0" if binary.is_none() => binary = Some(chunk),
            // Chunks of unknown kinds are to be ignored (glTF 2.0, section 4.4.3.1).
            _ => {}
        }
        // Chunks begin at multiples of four bytes.
        at = (start + size as usize).next_multiple_of(4);
    }
    json.map(|json| (json, binary)).ok_or_else(|| "the GLB has no JSON chunk; export it again".to_owned())
}

/// The document without the parts that never reach a light path.
pub(super) fn parse(json: &[u8]) -> Result<Root, String> {
    let not_gltf = |e| format!("not valid glTF JSON: {e}; export or download it again");
    let mut document: Value = deserialize::from_slice(json).map_err(not_gltf)?;
    let version = document.pointer("/asset/version").and_then(Value::as_str);
    let version = version.ok_or("not a glTF document: it has no asset version; export as glTF 2.0")?;
    if version != "2" && !version.starts_with("2.") {
        return Err(format!("glTF version {version:?}, expected \"2.0\"; export as glTF 2.0"));
    }
    if let Some(members) = document.as_object_mut() {
        members.remove("animations");
        members.remove("skins");
    }
    // A scene may be empty.
    if let Some(scenes) = document.get_mut("scenes").and_then(Value::as_array_mut) {
        for scene in scenes.iter_mut().filter_map(Value::as_object_mut) {
            scene.entry("nodes").or_insert_with(|| Value::Array(Vec::new()));
        }
    }
    remove_extras(&mut document);
    deserialize::from_value(document).map_err(not_gltf)
}

/// Removes application data, which may be anything. The parser limits the depth of nesting.
fn remove_extras(value: &mut Value) {
    match value {
        Value::Object(members) => {
            members.remove("extras");
            members.values_mut().for_each(remove_extras);
        }
        Value::Array(elements) => elements.iter_mut().for_each(remove_extras),
        _ => {}
    }
}
