//! Where a run keeps what it bakes, and how much memory it may take.

use std::path::{Path, PathBuf};

use clap::Args;
use serde_json::Value;

use super::Failure;
use crate::dataset::folder::slack;
use crate::dataset::{Bytes, DatasetError, Identity, Rendered};
use crate::measure::MeasurementPoints;
use crate::scene_file::SceneFile;
use crate::transfer;

/// Options of commands that bake a dataset.
#[derive(Args, Clone, Debug, Default)]
pub struct Storage {
    /// Folder that keeps the baked light, so that a run that was stopped goes on where it was, and more conditions can be
    /// added; or one that `relight export-conditions` wrote and another renderer filled, to train from its lightmaps
    /// [default: beside the model, NAME.dataset]
    #[arg(long, value_name = "DIR")]
    pub dataset: Option<PathBuf>,
    /// Most memory to take, such as 512MiB or 8GiB [default: three quarters of the machine's]; results do not depend on it
    #[arg(long, value_name = "BYTES")]
    pub memory: Option<Bytes>,
}

impl Storage {
    /// For a model at `model`.
    pub fn place(&self, model: &Path) -> Result<Place, Failure> {
        let folder = self.dataset.clone().unwrap_or_else(|| model.with_extension("dataset"));
        let rendered = Rendered::open(&folder)?;
        let folder = rendered.as_ref().map_or(folder, Rendered::shards);
        Ok(Place { folder, memory: self.memory.unwrap_or_else(Bytes::of_machine), rendered })
    }
}

/// The dataset's folder and the ceiling of memory.
#[derive(Clone, Debug)]
pub struct Place {
    /// Of our own shards.
    pub folder: PathBuf,
    pub memory: Bytes,
    /// Lightmaps that another renderer rendered, where they are to be trained from.
    pub rendered: Option<Rendered>,
}

impl Place {
    /// Refuses a run whose training would not fit, on `texels` covered texels.
    pub fn check_training(&self, scene: &SceneFile, texels: usize) -> Result<(), Failure> {
        let (bake, train) = (&scene.bake, &scene.train);
        let training = bake.conditions.first();
        let all = training + bake.held_out;
        let sub_points = MeasurementPoints::check(scene.points.count, scene.points.sub_points())?;
        let fit = transfer::bytes_needed(&transfer::Extent {
            method: train.method,
            channels: train.channels,
            elements: train.elements(),
            anchors: train.anchors,
            training,
            conditions: all,
            points: scene.points.count,
            sub_points: if train.prior { sub_points } else { 0 },
            texels,
            lightmap_size: scene.lightmap.size as usize,
            raised: scene.train.gamma() != 1.0,
        });
        let needed = Bytes(Bytes::resident().0 + slack() + fit);
        let so_far = Bytes(Bytes::peak().unwrap_or(0));
        let (what, needed, lower) = if needed > self.memory {
            let what = format!("training on {training} conditions and {} held out", bake.held_out);
            (what, needed, "--conditions, --basis or --size")
        } else if so_far > self.memory {
            ("reading the asset and laying out its lightmap".to_owned(), so_far, "--size")
        } else {
            return Ok(());
        };
        let advice = format!("; give more, or lower {lower}");
        Err(DatasetError::Memory { ceiling: self.memory, what, needed, advice }.into())
    }
}

/// The settings that a dataset depends on, by their names in the scene file; all but the numbers of conditions.
pub fn baked_settings(scene: &SceneFile) -> Identity {
    let mut settings = Identity::new();
    let rooms = [
        ("lightmap", serde_json::to_value(&scene.lightmap)),
        ("scenario", serde_json::to_value(&scene.scenario)),
        ("bake", serde_json::to_value(&scene.bake)),
    ];
    for (name, value) in rooms {
        flatten(name, &value.expect("settings have text for keys"), &mut settings);
    }
    for without_effect in ["bake.conditions", "bake.held_out", "bake.denoise"] {
        settings.remove(without_effect);
    }
    if scene.scenario.kinds.environment > 0.0 {
        for path in &scene.scenario.environments {
            // A file that cannot be read is told where it is read as an image.
            let hash = std::fs::read(path).map_or_else(|_| String::new(), |b| blake3::hash(&b).to_hex().to_string());
            settings.insert(format!("scenario.environments: content of {}", path.display()), hash);
        }
    }
    settings
}

fn flatten(name: &str, value: &Value, into: &mut Identity) {
    match value {
        Value::Object(fields) => {
            fields.iter().for_each(|(field, value)| flatten(&format!("{name}.{field}"), value, into));
        }
        Value::Null => {}
        other => _ = into.insert(name.to_owned(), other.to_string()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene_file::Conditions;

    #[test]
    fn another_image_in_an_environments_file_is_another_dataset() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("map.hdr");
        let mut scene = SceneFile::cornell();
        scene.scenario.kinds.environment = 1.0;
        scene.scenario.environments = vec![path.clone()];
        let with = |content: &str| {
            std::fs::write(&path, content).unwrap();
            baked_settings(&scene)
        };
        assert_eq!(with("one"), with("one"));
        assert_ne!(with("one"), with("two"));
        // What changes no bit of the bake changes nothing.
        let mut more = scene.clone();
        (more.bake.conditions, more.bake.denoise) = (Conditions::Count(7), Some(false));
        assert_eq!(baked_settings(&more), baked_settings(&scene));
    }
}
