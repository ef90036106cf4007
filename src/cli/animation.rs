//! `relight render --path`: lights that move, frame by frame, into numbered pictures or one animated PNG.

use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};
use std::time::Instant;

use serde_json::json;
use tempfile::TempDir;

use super::render::{Render, Renderer};
use super::{Failure, Reporter};
use crate::light::{Light, LightPath};
use crate::model::scope::Reading;
use crate::model::{Animation, Model, Picture, View};
use crate::progress::Progress;
use crate::report::pictures;

const MOST_FRAMES: u32 = 100_000;
/// Frames a second where nothing else is said.
const RATE: f32 = 30.0;
/// Frames that decide the exposure, at most.
const EXPOSED: usize = 24;

/// How many frames there are, and how fast they follow each other.
#[derive(Debug, PartialEq)]
struct Timing {
    frames: u32,
    frames_per_second: f32,
}

impl Timing {
    fn new(duration: f32, frames: Option<u32>, rate: Option<f32>) -> Result<Self, Failure> {
        if frames.is_some_and(|n| !(1..=MOST_FRAMES).contains(&n)) {
            return Err(Failure::Input(format!("--frames must be from 1 to {MOST_FRAMES}")));
        }
        if rate.is_some_and(|r| !(0.1..=1000.0).contains(&r)) {
            return Err(Failure::Input("--fps must be from 0.1 to 1000".into()));
        }
        let of_rate = (duration * rate.unwrap_or(RATE)).round().max(1.0);
        if frames.is_none() && of_rate > MOST_FRAMES as f32 {
            return Err(Failure::Input(format!(
                "a path of {duration} s has {of_rate} frames, more than {MOST_FRAMES}; choose fewer with --frames"
            )));
        }
        let frames = frames.unwrap_or(of_rate as u32);
        Ok(Self { frames, frames_per_second: rate.unwrap_or(frames as f32 / duration) })
    }
}

/// Where the frames go.
#[derive(Debug, PartialEq)]
enum Target {
    /// One animated PNG.
    Animation(PathBuf),
    /// Pictures called `before`, a number of at least so many digits, `after`.
    Frames { folder: PathBuf, before: String, digits: usize, after: String },
}

impl Target {
    fn of(output: &Path) -> Result<Self, Failure> {
        let wrong = || {
            Failure::Input(format!(
                "{}: animations are one .png or .apng, or numbered pictures: a name such as frames/%04d.png or .exr, or a folder",
                output.display()
            ))
        };
        let name = output.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        let folder = output.parent().unwrap_or(Path::new("")).to_owned();
        let extension = Path::new(&name).extension().map(|e| e.to_string_lossy().to_lowercase());
        if let Some((before, rest)) = name.split_once('%') {
            let (digits, after) = rest.split_once('d').ok_or_else(wrong)?;
            let width = digits.strip_prefix('0').unwrap_or(if digits.is_empty() { "1" } else { "no" });
            let digits = width.parse().ok().filter(|n| (1..=9).contains(n)).ok_or_else(wrong)?;
            if after.contains('%') || !matches!(extension.as_deref(), Some("png" | "exr")) {
                return Err(wrong());
            }
            return Ok(Target::Frames { folder, before: before.to_owned(), digits, after: after.to_owned() });
        }
        let is_folder = output.is_dir() || output.as_os_str().to_string_lossy().ends_with(['/', '\\']);
        match extension.as_deref() {
            Some("png" | "apng") if !is_folder => Ok(Target::Animation(output.to_owned())),
            _ if is_folder || extension.is_none() => {
                Ok(Target::Frames { folder: output.to_owned(), before: String::new(), digits: 4, after: ".png".into() })
            }
            _ => Err(wrong()),
        }
    }

    fn is_exr(&self) -> bool {
        matches!(self, Target::Frames { after, .. } if after.to_lowercase().ends_with(".exr"))
    }

    fn frame_name(before: &str, digits: usize, after: &str, frame: usize) -> String {
        format!("{before}{frame:0digits$}{after}")
    }
}

/// Frames that are kept apart until all of them are there.
struct Stage {
    folder: TempDir,
    animation: Option<Animation<BufWriter<std::fs::File>>>,
}

impl Stage {
    const ANIMATION: &str = "animation.png";

    /// In the folder above the results that is there already, so that they are only renamed in the end.
    fn new(target: &Target, size: [u32; 2], timing: &Timing) -> io::Result<Self> {
        let goal = match target {
            Target::Animation(file) if file.is_dir() => return Err(io::ErrorKind::IsADirectory.into()),
            Target::Animation(file) => file.parent().unwrap_or(Path::new("")),
            Target::Frames { folder, .. } => folder,
        };
        let above = goal.ancestors().find(|folder| folder.exists()).unwrap_or(Path::new("."));
        let folder = tempfile::Builder::new().prefix(".relight-").tempdir_in(above)?;
        let animation = match target {
            Target::Animation(_) => {
                let file = BufWriter::new(std::fs::File::create(folder.path().join(Self::ANIMATION))?);
                Some(Animation::new(file, size, timing.frames, timing.frames_per_second)?)
            }
            Target::Frames { .. } => None,
        };
        Ok(Self { folder, animation })
    }

    fn add(&mut self, target: &Target, frame: usize, picture: &Picture, exposure: f32) -> io::Result<()> {
        match (&mut self.animation, target) {
            (Some(animation), _) => animation.add(picture, exposure),
            (None, Target::Frames { before, digits, after, .. }) => {
                let bytes = if target.is_exr() {
                    picture.to_exr().map_err(io::Error::other)?
                } else {
                    picture.to_png(exposure)
                };
                std::fs::write(self.folder.path().join(Target::frame_name(before, *digits, after, frame)), bytes)
            }
            (None, Target::Animation(_)) => unreachable!("an animation is begun with its stage"),
        }
    }

    /// Puts everything in its place.
    fn finish(self, target: &Target, frames: usize) -> io::Result<()> {
        match target {
            Target::Animation(file) => {
                self.animation.map_or(Ok(()), Animation::finish)?;
                if let Some(folder) = file.parent() {
                    std::fs::create_dir_all(folder)?;
                }
                std::fs::rename(self.folder.path().join(Self::ANIMATION), file)
            }
            Target::Frames { folder, before, digits, after } => {
                std::fs::create_dir_all(folder)?;
                for frame in 0..frames {
                    let name = Target::frame_name(before, *digits, after, frame);
                    std::fs::rename(self.folder.path().join(&name), folder.join(&name))?;
                }
                Ok(())
            }
        }
    }
}

/// Stops work when it is to be stopped, and tells nothing of it: each frame has the same to tell.
pub struct Untold<'a>(pub &'a Reporter);

impl Progress for Untold<'_> {
    fn begin(&self, _: &str, _: u64, _: &str) {}
    fn advance(&self, _: u64) {}
    fn end(&self) {}
    fn note(&self, line: &str) {
        self.0.note(line);
    }
    fn cancelled(&self) -> bool {
        self.0.cancelled()
    }
}

impl Render {
    /// Renders the frames of `path`, with `still` lights in all of them.
    pub(super) fn animate(
        &self,
        model: &Model,
        view: &View,
        (path, file): (&LightPath, &Path),
        still: &[Light],
        json: Option<&Path>,
        reporter: &Reporter,
    ) -> Result<(), Failure> {
        if !path.moves() {
            return Err(Failure::Input(format!(
                "--path {}: nothing moves: no value has two keyframes, as intensity = [{{ time = 0, value = 1 }}, {{ time = 2, value = 5 }}] has",
                file.display()
            )));
        }
        let target = Target::of(&self.output)?;
        let timing = Timing::new(path.duration(), self.frames, self.fps)?;
        // The path begins anew where it ends: the frame after the last one is the first.
        let seconds = |frame: u32| path.duration() * (frame as f32 / timing.frames as f32);
        let lights_at = |frame: u32| -> Result<Vec<Light>, Failure> {
            let moving =
                path.at(seconds(frame)).map_err(|e| Failure::Input(format!("--path {}: {e}", file.display())))?;
            Ok([still, &moving].concat())
        };
        let frames = (0..timing.frames).map(lights_at).collect::<Result<Vec<_>, _>>()?;

        let failed = |e: io::Error| Failure::Work(format!("{}: cannot be written: {e}", self.output.display()));
        let mut stage = Stage::new(&target, [view.width, view.height], &timing).map_err(failed)?;
        reporter.scratch(stage.folder.path());
        let start = Instant::now();
        let quiet = Untold(reporter);
        let mut renderer = Renderer::new(self, model)?;
        let exposure = match self.exposure {
            Some(exposure) => exposure,
            None if target.is_exr() => 1.0,
            None => self.exposure_of_all(&mut renderer, view, &frames, reporter)?,
        };
        reporter.begin("render", timing.frames as u64, "frames");
        let mut farthest: Option<(u32, Reading)> = None;
        for (lights, frame) in frames.iter().zip(0..) {
            let (picture, direct) = renderer.picture(view, lights, self.show, &quiet)?;
            if reporter.cancelled() {
                return Err(Failure::Stopped);
            }
            let reading = model.scope.as_ref().zip(direct.as_ref()).and_then(|(scope, direct)| scope.read(direct));
            if let Some(reading) = reading
                && farthest.as_ref().is_none_or(|(_, r)| reading.novelty > r.novelty)
            {
                farthest = Some((frame, reading));
            }
            stage.add(&target, frame as usize, &picture, exposure).map_err(failed)?;
            reporter.advance(1);
        }
        reporter.end();
        stage.finish(&target, frames.len()).map_err(failed)?;
        let taken = start.elapsed().as_secs_f64();
        let Timing { frames, frames_per_second } = timing;
        let name = renderer.name();
        say!(
            "wrote {} ({name}, {frames} frames, {} a second, {taken:.1} s)",
            self.output.display(),
            (frames_per_second * 100.0).round() / 100.0
        );
        if let Some((frame, reading)) = &farthest {
            say!("lights, at their farthest from training (frame {frame}): {}", reading.verdict());
        }
        let figures = json!({
            "renderer": name,
            "seconds": taken,
            "width": view.width,
            "height": view.height,
            "frames": frames,
            "frames_per_second": frames_per_second,
            "exposure": exposure,
            "novelty": farthest.as_ref().map(|(_, r)| r.novelty),
            "like": farthest.map(|(_, r)| r.like),
        });
        super::write_json(json, &figures)
    }

    /// One exposure for all frames, that of the brightest: so its bright parts come out just under white, and what is dimmer is.
    /// Asked of small pictures of some frames.
    fn exposure_of_all(
        &self,
        renderer: &mut Renderer,
        view: &View,
        frames: &[Vec<Light>],
        reporter: &Reporter,
    ) -> Result<f32, Failure> {
        let small = View::new(view.camera.clone(), view.width.div_ceil(4), view.height.div_ceil(4));
        let some = frames.len().min(EXPOSED);
        reporter.begin("expose", some as u64, "frames");
        let mut least = f32::INFINITY;
        for i in 0..some {
            let (picture, _) =
                renderer.picture(&small, &frames[i * frames.len() / some], self.show, &Untold(reporter))?;
            if reporter.cancelled() {
                return Err(Failure::Stopped);
            }
            if picture.pixels.iter().any(|p| p.max_element() > 0.0) {
                least = least.min(pictures::exposure_for(&picture));
            }
            reporter.advance(1);
        }
        reporter.end();
        Ok(if least.is_finite() { least } else { 1.0 })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_results_tell_what_they_are() {
        let of = |name: &str| Target::of(Path::new(name)).ok();
        let frames = |folder: &str, before: &str, digits, after: &str| {
            let (before, after) = (before.to_owned(), after.to_owned());
            Some(Target::Frames { folder: folder.into(), before, digits, after })
        };
        assert_eq!(of("a/b.png"), Some(Target::Animation("a/b.png".into())));
        assert_eq!(of("b.APNG"), Some(Target::Animation("b.APNG".into())));
        assert_eq!(of("frames"), frames("frames", "", 4, ".png"));
        assert_eq!(of("v1.2/"), frames("v1.2/", "", 4, ".png"));
        assert_eq!(of("a/lamp-%03d.exr"), frames("a", "lamp-", 3, ".exr"));
        assert_eq!(of("%d.png"), frames("", "", 1, ".png"));
        assert_eq!(Target::frame_name("lamp-", 3, ".exr", 7), "lamp-007.exr");
        for wrong in ["a.gif", "a.exr", "%04d.gif", "%04d", "%s.png", "%4d.png", "%0d.png", "%d%d.png", "%099d.png"] {
            assert!(of(wrong).is_none(), "{wrong}");
        }
    }

    #[test]
    fn frames_and_their_rate_follow_from_each_other() {
        let of = |frames, rate| Timing::new(4.0, frames, rate).map(|t| (t.frames, t.frames_per_second)).ok();
        assert_eq!(of(None, None), Some((120, 30.0)));
        assert_eq!(of(Some(60), None), Some((60, 15.0)));
        assert_eq!(of(None, Some(25.0)), Some((100, 25.0)));
        assert_eq!(of(Some(60), Some(25.0)), Some((60, 25.0)));
        for wrong in [(Some(0), None), (None, Some(0.0)), (None, Some(f32::NAN)), (Some(MOST_FRAMES + 1), None)] {
            assert_eq!(of(wrong.0, wrong.1), None, "{wrong:?}");
        }
        assert!(Timing::new(1e9, None, None).is_err());
    }
}
