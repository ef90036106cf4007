//! Lightmaps in OpenEXR files.

use std::path::Path;

use crate::scene::Texel;

/// Values of the covered texels, `[texel][channel]`, from an OpenEXR file of `size` × `size` pixels whose first scan line is at
/// v = 0: channels `LAYER.R`, `.G` and `.B`, or R, G and B.
///
/// # Errors
/// What is wrong with the file: unreadable, of another size, without these channels, with a value that is no light.
pub fn read(path: &Path, layer: &str, size: usize, texels: &[Texel]) -> Result<Vec<f32>, String> {
    use exr::prelude::*;
    let failed = |e: Error| format!("cannot be read: {}", one_line(&e.to_string()));
    // The headers alone tell the size, before anything is reserved for it.
    let headers = MetaData::read_from_file(path, false).map_err(failed)?.headers;
    if let Some(other) = headers.iter().map(|h| h.layer_size).find(|&s| s != Vec2(size, size)) {
        return Err(format!("{} x {} pixels, the lightmap has {size} x {size}", other.0, other.1));
    }
    let reader = exr::prelude::read().no_deep_data().largest_resolution_level().all_channels().all_layers();
    // Files are read side by side.
    let image = reader.all_attributes().non_parallel().from_file(path).map_err(failed)?;
    let mut named = Vec::new();
    for part in &image.layer_data {
        let prefix = part.attributes.layer_name.as_ref().map(|name| format!("{name}.")).unwrap_or_default();
        for channel in &part.channel_data.list {
            named.push((format!("{prefix}{}", channel.name), channel.name.to_string(), &channel.sample_data));
        }
    }
    let find = |wanted: &str| {
        let full = format!("{layer}.{wanted}");
        let by = |name: &str| named.iter().find(|(long, short, _)| long == name || short == name).map(|n| n.2);
        by(&full).or_else(|| by(wanted))
    };
    let [Some(r), Some(g), Some(b)] = ["R", "G", "B"].map(find) else {
        let there = named.iter().map(|(long, ..)| long.as_str()).collect::<Vec<_>>().join(", ");
        return Err(format!("has no channels {layer}.R, .G and .B, nor R, G and B (it has {})", one_line(&there)));
    };
    let planes = [r, g, b].map(|samples| samples.values_as_f32().collect::<Vec<f32>>());
    if planes.iter().any(|plane| plane.len() != size * size) {
        return Err("its channels are subsampled".into());
    }
    let mut values = Vec::with_capacity(3 * texels.len());
    for texel in texels {
        for (plane, channel) in planes.iter().zip(["R", "G", "B"]) {
            let value = plane[texel.index as usize];
            if !value.is_finite() || value < 0.0 {
                let (x, y) = (texel.index as usize % size, texel.index as usize / size);
                return Err(format!("the {channel} of column {x}, row {y} is {value}, which is no light"));
            }
            values.push(value);
        }
    }
    Ok(values)
}

pub(super) fn one_line(message: &str) -> String {
    message.split_whitespace().collect::<Vec<_>>().join(" ")
}
