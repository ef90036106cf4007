//! Lights that move, rendered by the program: numbered pictures and animated PNGs.

#[path = "common/work.rs"]
mod work;

use std::io::Cursor;
#[cfg(unix)]
use std::time::{Duration, Instant};

use work::{POINT, Work};

/// A lamp that goes to the right and comes back, a second each way, brightest at the far end.
const LAMP: &str = r#"
interpolation = "linear"
[[lights]]
type = "point"
position = [
    { time = 0, value = [1.5, 4, 2] },
    { time = 1, value = [4, 4, 2] },
    { time = 2, value = [1.5, 4, 2] },
]
intensity = [{ time = 0, value = 10 }, { time = 1, value = 30 }, { time = 2, value = 10 }]
"#;

fn still(x: f32, intensity: f32) -> String {
    format!("{{type=\"point\", position=[{x},4,2], intensity={intensity}}}")
}

/// Frames of an animation, each whole, and the seconds for which one is shown.
fn frames(bytes: &[u8]) -> (Vec<Vec<u8>>, f32) {
    let mut reader = png::Decoder::new(Cursor::new(bytes)).read_info().unwrap();
    let count = reader.info().animation_control().unwrap().num_frames;
    let (width, height) = (reader.info().width as usize, reader.info().height as usize);
    let mut canvas = vec![0u8; 3 * width * height];
    let (mut all, mut shown) = (Vec::new(), 0.0);
    for _ in 0..count {
        let mut part = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut part).unwrap();
        let control = *reader.info().frame_control().unwrap();
        let row = 3 * control.width as usize;
        for y in 0..control.height as usize {
            let to = 3 * ((control.y_offset as usize + y) * width + control.x_offset as usize);
            canvas[to..to + row].copy_from_slice(&part[y * row..(y + 1) * row]);
        }
        shown = control.delay_num as f32 / control.delay_den as f32;
        all.push(canvas.clone());
    }
    (all, shown)
}

fn picture(work: &Work, name: &str) -> Vec<u8> {
    image::open(work.path(name)).unwrap().into_rgb8().into_raw()
}

/// Each frame is the picture that `render` makes of the lights of its moment, with one exposure for all of them.
#[test]
fn frames_are_the_pictures_of_their_moments() {
    let work = Work::with_model();
    work.put("lamp.toml", LAMP);
    let said = work.succeeds(
        "render model.relight --cpu --size 24x16 --path lamp.toml --frames 8 -o deep/%03d.png --json a.json",
        &[],
    );
    assert!(said.contains("wrote deep/%03d.png") && said.contains("8 frames, 4 a second"), "{said}");
    let figures = work.json("a.json");
    assert_eq!((&figures["frames"], &figures["frames_per_second"]), (&8.into(), &4.0.into()));
    let exposure = figures["exposure"].as_f64().unwrap();
    let of_lights = |x: f32, intensity: f32| {
        let words = format!("render model.relight --cpu --size 24x16 --exposure {exposure} -o still.png");
        work.succeeds(&words, &["--light", &still(x, intensity)]);
        picture(&work, "still.png")
    };
    // A frame each quarter of a second.
    for (frame, x, intensity) in [(0, 1.5, 10.0), (1, 2.125, 15.0), (4, 4.0, 30.0), (6, 2.75, 20.0)] {
        assert_eq!(picture(&work, &format!("deep/{frame:03}.png")), of_lights(x, intensity), "frame {frame}");
    }
    assert_ne!(picture(&work, "deep/001.png"), of_lights(1.5, 10.0), "another moment goes unnoticed");
    let files: Vec<String> =
        work.files().into_iter().filter(|name| name.starts_with("deep/") || name.starts_with('.')).collect();
    assert_eq!(files, (0..8).map(|i| format!("deep/{i:03}.png")).collect::<Vec<_>>(), "and nothing else");
    // The brightest frame has the exposure that it would have alone, but for the size that this is judged at.
    work.succeeds("render model.relight --cpu --size 24x16 -o alone.png", &["--light", &still(4.0, 30.0)]);
    let brightness = |bytes: &[u8]| bytes.iter().map(|&b| b as f32).sum::<f32>();
    let (alone, shown) = (brightness(&picture(&work, "alone.png")), brightness(&picture(&work, "deep/004.png")));
    assert!((shown / alone - 1.0).abs() < 0.1, "{shown} {alone}");
    assert!(brightness(&picture(&work, "deep/000.png")) < 0.8 * shown, "a dim frame is dim");
}

#[test]
fn an_animation_has_the_same_frames() {
    let work = Work::with_model();
    work.put("lamp.toml", LAMP);
    let render = "render model.relight --cpu --size 24x16 --path lamp.toml";
    work.succeeds(&format!("{render} --frames 6 -o new/a.png --json a.json"), &[]);
    let exposure = work.json("a.json")["exposure"].as_f64().unwrap();
    work.succeeds(&format!("{render} --frames 6 --exposure {exposure} -o frames"), &[]);
    let (all, shown) = frames(&std::fs::read(work.path("new/a.png")).unwrap());
    assert_eq!((all.len(), shown), (6, 1.0 / 3.0));
    for (i, frame) in all.iter().enumerate() {
        assert_eq!(*frame, picture(&work, &format!("frames/{i:04}.png")), "frame {i}");
    }
    // There and back: the second frame is the last one.
    assert!(all[1] == all[5] && all[1] != all[2]);

    let said = work.succeeds(&format!("{render} --fps 5 --light {{type=\"emissive\"}} -o b.apng"), &[]);
    assert!(said.contains("10 frames, 5 a second"), "{said}");
    assert_eq!(frames(&std::fs::read(work.path("b.apng")).unwrap()).1, 0.2);
    // Radiance, and lights that stay beside those that move.
    work.succeeds(&format!("{render} --frames 2 -o dim%d.exr"), &[]);
    work.succeeds(&format!("{render} --frames 2 -o lit%d.exr"), &["--light", POINT]);
    let sum = |name: &str| {
        let image = exr::prelude::read_first_flat_layer_from_file(work.path(name)).unwrap();
        let channels = image.layer_data.channel_data.list;
        channels.iter().flat_map(|c| c.sample_data.values_as_f32()).map(f64::from).sum::<f64>()
    };
    assert!(sum("dim1.exr") > 2.5 * sum("dim0.exr") && sum("lit0.exr") > 1.5 * sum("dim0.exr"));
}

#[test]
fn what_cannot_be_animated_is_said_in_one_line() {
    let work = Work::with_model();
    work.put("lamp.toml", LAMP).put("lamp.json", "{\"lights\": [\n{}]}").put("file", "");
    let refused = |more: &[&str], expected: &str| work.fails(2, "render model.relight --cpu", more, expected);
    let path = |text: &str, expected: &str| {
        work.put("bad.toml", text);
        refused(&["-o", "a.png", "--path", "bad.toml"], expected);
    };
    let lamp = "[[lights]]\ntype = \"point\"\nposition = [2, 4, 2]\n";
    path("", "bad.toml: line 1: missing field `lights`");
    path("lights = []", "bad.toml: no light is given");
    path(&format!("{lamp}intensity = 3"), "--path bad.toml: nothing moves");
    path(&format!("{lamp}intensity = [{{ time = 0, value = 1 }}]"), "--path bad.toml: nothing moves");
    path(
        &format!("{lamp}intensity = [{{ time = 2, value = 1 }}, {{ time = 1, value = 1 }}]"),
        "bad.toml: light 1: intensity: keyframe 2: its time, 1 s, is not after 2 s",
    );
    path(&format!("{lamp}intensity = [{{ time = nan, value = 1 }}]"), "keyframe 1: time NaN must be finite");
    path(&format!("{lamp}intensity = [{{ time = 0, value = nan }}]"), "keyframe 1: value NaN is not a finite number");
    path(&format!("{lamp}brightness = 2"), "unknown field `brightness`");
    path(&format!("{lamp}intensity = [{{ time = 0, value = 1 "), "bad.toml: line 4: ");
    path(
        "[[lights]]\ntype = \"spot\"\nposition = [2, 4, 2]\ndirection = [0, -1, 0]\nintensity = 1\n\
         inner_cone_angle = [{ time = 0, value = 0.1 }, { time = 1, value = 0.5 }]\n\
         outer_cone_angle = [{ time = 0, value = 0.2 }, { time = 0.9, value = 0.2 }, { time = 1, value = 0.6 }]",
        "light 1 at 0.9 s: cone angles",
    );
    refused(&["-o", "a.png", "--path", "gone.toml"], "--path gone.toml: cannot be read");
    refused(&["-o", "a.png", "--path", "lamp.json"], "lamp.json: light 1: ");
    let of_lamp = |more: &[&str], expected: &str| refused(&[&["--path", "lamp.toml"], more].concat(), expected);
    of_lamp(&["-o", "a.png", "--frames", "0"], "--frames must be from 1 to 100000");
    of_lamp(&["-o", "a.png", "--fps", "0"], "--fps must be from 0.1 to 1000");
    of_lamp(&["-o", "a.png", "--fps", "nan"], "--fps must be from 0.1 to 1000");
    of_lamp(&["-o", "a.gif"], "a.gif: animations are one .png or .apng, or numbered pictures");
    of_lamp(&["-o", "%04d.gif"], "%04d.gif: animations are");
    of_lamp(&["-o", "a.png", "--size", "0x3"], "a picture of 0 x 3 pixels");
    refused(&["-o", "a.png", "--light", "lamp.toml"], "its lights move: give it with --path");
    let fails = |output: &str| {
        let words = format!("render model.relight --cpu --size 4x4 --path lamp.toml --frames 2 -o {output}");
        work.fails(1, &words, &[], "cannot be written");
    };
    fails("file/a.png");
    fails("file/%d.png");
    std::fs::create_dir(work.path("taken.png")).unwrap();
    // A folder of that name is one for the frames.
    work.succeeds("render model.relight --cpu --size 4x4 --path lamp.toml --frames 2 -o taken.png", &[]);
    assert!(work.files().contains("taken.png/0001.png"));
}

#[cfg(unix)]
#[test]
fn ctrl_c_leaves_nothing_of_an_animation() {
    let work = Work::with_model();
    work.put("lamp.toml", LAMP);
    let before = work.files();
    // Between frames, and in the middle of one that takes minutes.
    for size in ["64x48 --cpu", "400x300 --reference --paths 100000"] {
        for output in ["a.png", "frames/%d.png"] {
            let words =
                format!("render model.relight --size {size} --path lamp.toml --frames 5000 -o {output} --exposure 1");
            let child = std::process::Command::new(env!("CARGO_BIN_EXE_relight"))
                .current_dir(work.0.path())
                .args(words.split(' '))
                .stdout(std::process::Stdio::piped())
                .stderr(std::process::Stdio::piped())
                .spawn()
                .unwrap();
            // Until it has begun to write.
            let start = Instant::now();
            while work.files() == before && start.elapsed() < Duration::from_secs(60) {
                std::thread::sleep(Duration::from_millis(20));
            }
            std::thread::sleep(Duration::from_millis(300));
            let interrupted = Instant::now();
            assert!(
                std::process::Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success()
            );
            let output = child.wait_with_output().unwrap();
            let stderr = String::from_utf8(output.stderr).unwrap();
            assert!(interrupted.elapsed() < Duration::from_secs(2), "took {:?} to stop", interrupted.elapsed());
            assert_eq!(output.status.code(), Some(1), "{stderr}");
            assert!(stderr.contains("stopped; nothing was written") && output.stdout.is_empty(), "{stderr}");
            assert_eq!(work.files(), before, "{size}: something stays");
        }
    }
}
