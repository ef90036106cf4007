//! Panels, windows and keys.

use eframe::egui::{self, Color32, DragValue, Key, Modifiers, Panel, RichText, ScrollArea, Slider, Ui};
use egui_plot::{Legend, Line, Plot, PlotPoints};
use glam::Vec3;

use super::app::App;
use super::control;
use super::display::What;
use super::screen::Side;
use crate::light::{Kind, Light, Sky};
use crate::model::Shown;

const HELP: &[(&str, &str)] = &[
    ("drag", "orbit; with Shift or the middle button: pan; with the right button: look around"),
    ("scroll", "zoom"),
    ("W A S D Q E", "fly"),
    ("double click", "orbit about what is there"),
    ("drag a light", "move it; the coloured ends move it along an axis, the white end aims it"),
    ("Tab", "select the next light"),
    ("arrows, PageUp, PageDown", "move the selected light along x, z and y"),
    ("Delete", "remove the selected light"),
    ("1 2 3", "all light, direct, indirect"),
    ("X", "split: a second method, size, the reference or the difference"),
    ("R, C", "path traced reference on the right, or the difference from it"),
    ("P", "measurement points and their values"),
    ("B", "basis elements"),
    ("T", "timings"),
    ("H", "handles"),
    ("Space", "play the light path; without one the selected light goes around"),
    ("K", "keyframe: the path has the lights as they are at its present time"),
    ("[ ]", "exposure"),
    ("F", "back to the first view"),
    ("Ctrl+S", "save the picture, .png and .exr"),
    ("Ctrl+L", "save the lights, .toml"),
    ("Ctrl+P", "save the light path, .path.toml"),
    (
        "drop a file",
        "environment map (.hdr, .exr; in the place of a selected one), lights or a light path (.toml, .json)",
    ),
    ("Ctrl+Q", "quit"),
];

const KINDS: [Kind; 8] =
    [Kind::Point, Kind::Spot, Kind::Directional, Kind::Rect, Kind::Disk, Kind::Sphere, Kind::Sky, Kind::Emissive];

impl App<'_> {
    pub(super) fn keys(&mut self, ui: &Ui) {
        self.free_keys(ui.ctx());
        if ui.ctx().egui_wants_keyboard_input() {
            return;
        }
        // By what was held when the key was pressed, not when the frame ends.
        let pressed = |key: Key| {
            let plain = |event: &egui::Event| match event {
                egui::Event::Key { key: of, pressed: true, modifiers, .. } => *of == key && modifiers.is_none(),
                _ => false,
            };
            ui.input(|i| i.events.iter().any(plain))
        };
        let command = |key: Key| ui.input_mut(|i| i.consume_key(Modifiers::COMMAND, key));
        if command(Key::S) {
            self.save_picture();
        }
        if command(Key::L) {
            self.save_lights();
        }
        if command(Key::P) {
            self.save_path();
        }
        if command(Key::Q) {
            ui.ctx().send_viewport_cmd(egui::ViewportCommand::Close);
        }
        if ui.input(|i| i.key_pressed(Key::Questionmark) || i.key_pressed(Key::F1)) {
            self.help = !self.help;
        }
        for (key, part) in [(Key::Num1, Shown::Full), (Key::Num2, Shown::Direct), (Key::Num3, Shown::Indirect)] {
            if pressed(key) {
                self.part = part;
                self.redraw();
            }
        }
        if pressed(Key::X) {
            self.set_split(if self.sides[1].is_some() { None } else { Some(What::Picture) });
        }
        for (key, what) in [(Key::R, What::Reference), (Key::C, What::Difference)] {
            if pressed(key) {
                let has = self.sides[1].is_some_and(|side| side.what == what);
                self.set_split(if has { None } else { Some(what) });
            }
        }
        for (key, flag) in [
            (Key::P, &mut self.show_points),
            (Key::B, &mut self.show_basis),
            (Key::T, &mut self.show_timings),
            (Key::H, &mut self.show_handles),
        ] {
            *flag ^= pressed(key);
        }
        if pressed(Key::Space) {
            self.toggle_playing();
        }
        if pressed(Key::K) {
            self.set_key();
        }
        for (key, factor) in [(Key::OpenBracket, 0.8), (Key::CloseBracket, 1.25)] {
            if pressed(key) {
                self.look.exposure *= factor;
            }
        }
        if pressed(Key::F) {
            self.camera = self.home.clone();
            self.redraw();
        }
        if pressed(Key::Tab) && !self.lights.is_empty() {
            self.selected = Some(self.selected.map_or(0, |i| (i + 1) % self.lights.len()));
        }
        if pressed(Key::Delete)
            && let Some(index) = self.selected.filter(|&i| i < self.lights.len())
        {
            self.remove(index);
        }
        self.nudge(ui);
    }

    /// Keys are the scene's, but for those of a number that is being typed: a button or slider does not keep them once it was
    /// clicked. A number becomes a text only in the frame after the click.
    fn free_keys(&mut self, context: &egui::Context) {
        let focused = context.memory(|memory| memory.focused());
        if let Some(id) = focused
            && !context.text_edit_focused()
        {
            if self.focused == focused {
                context.memory_mut(|memory| memory.surrender_focus(id));
            }
            context.request_repaint();
        }
        self.focused = focused;
    }

    /// Keys move the selected light by a fiftieth of the asset's extent.
    fn nudge(&mut self, ui: &Ui) {
        let step = 0.02 * self.extent();
        let moves = [
            (Key::ArrowRight, Vec3::X),
            (Key::ArrowLeft, Vec3::NEG_X),
            (Key::PageUp, Vec3::Y),
            (Key::PageDown, Vec3::NEG_Y),
            (Key::ArrowDown, Vec3::Z),
            (Key::ArrowUp, Vec3::NEG_Z),
        ];
        let by: Vec3 = ui.input(|i| moves.iter().map(|&(key, to)| to * i.num_presses(key) as f32).sum());
        if by != Vec3::ZERO
            && let Some(light) = self.selected.and_then(|i| self.lights.get_mut(i))
            && let Some(position) = light.position_mut()
        {
            *position += by * step;
            self.edited();
        }
    }

    fn remove(&mut self, index: usize) {
        self.lights.remove(index);
        self.selected = self.lights.len().checked_sub(1).map(|last| index.min(last));
        self.edited();
    }

    fn set_split(&mut self, what: Option<What>) {
        let left = self.sides[0].expect("the left side is always shown");
        // Beside a picture of the same: the next model, where there is one.
        let model = (left.model + 1) % self.names.len();
        self.sides[1] = what.map(|what| match what {
            What::Picture => Side { what, model, elements: self.screen.model(model).transfer.elements },
            _ => Side { what, ..left },
        });
        self.relight();
    }

    pub(super) fn side_name(&self, at: usize) -> String {
        let Some(side) = self.sides[at] else { return String::new() };
        let name = &self.names[side.model];
        let model = self.screen.model(side.model);
        let size = match &model.basis.anchors {
            Some(_) => format!("{} channels, local", model.basis.elements),
            None => format!("{} elements", side.elements),
        };
        match side.what {
            What::Picture => format!("{name}, {size}"),
            What::Reference => format!("path traced, {} paths", self.reference_paths),
            What::Difference => format!("difference of {name}, {size}"),
        }
    }

    pub(super) fn panels(&mut self, ui: &mut Ui) {
        Panel::bottom("status").show(ui, |ui| self.status(ui));
        Panel::left("lights").default_size(230.0).show(ui, |ui| {
            ScrollArea::vertical().show(ui, |ui| self.lights_panel(ui));
        });
        Panel::right("view").default_size(250.0).show(ui, |ui| {
            ScrollArea::vertical().show(ui, |ui| self.view_panel(ui));
        });
        // Windows open over the scene, not over the panels.
        self.corner = ui.available_rect_before_wrap().min + egui::vec2(8.0, 8.0);
        if self.show_timings {
            Panel::bottom("timings").default_size(170.0).resizable(true).show(ui, |ui| self.timings(ui));
        }
        let context = ui.ctx().clone();
        self.basis_window(&context);
        let mut help = self.help;
        let corner = self.corner;
        egui::Window::new("Help").open(&mut help).default_pos(corner).show(&context, |ui| {
            egui::Grid::new("keys").num_columns(2).striped(true).show(ui, |ui| {
                for (key, does) in HELP {
                    ui.label(RichText::new(*key).strong());
                    ui.label(*does);
                    ui.end_row();
                }
            });
        });
        self.help = help;
    }

    fn status(&mut self, ui: &mut Ui) {
        ui.horizontal(|ui| {
            if let Some(failure) = &self.failure {
                ui.colored_label(Color32::LIGHT_RED, failure);
                return;
            }
            ui.label(&self.message);
            ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
                if let Some(frame) = self.pace.history.back() {
                    ui.label(format!("{:.1} ms", frame.total));
                }
                if self.wants_reference() {
                    ui.label(format!("reference: {} paths a pixel", self.reference_paths));
                }
            });
        });
    }

    fn lights_panel(&mut self, ui: &mut Ui) {
        ui.heading("Lights");
        ui.menu_button("add a light", |ui| {
            for kind in KINDS {
                if ui.button(kind.name()).clicked() {
                    let light = self.new_light(kind);
                    self.lights.push(light);
                    self.selected = Some(self.lights.len() - 1);
                    self.edited();
                    ui.close();
                }
            }
        });
        let mut removed = None;
        for i in 0..self.lights.len() {
            ui.horizontal(|ui| {
                let name = format!("{} {}", i + 1, self.lights[i].kind().name());
                if ui.selectable_label(self.selected == Some(i), name).clicked() {
                    self.selected = Some(i);
                }
                if ui.small_button("x").on_hover_text("remove (Delete)").clicked() {
                    removed = Some(i);
                }
            });
        }
        if let Some(index) = removed {
            self.remove(index);
        }
        ui.separator();
        let (extent, mut changed) = (self.extent(), false);
        if let Some(light) = self.selected.and_then(|i| self.lights.get_mut(i)) {
            changed = edit(ui, light, extent);
        }
        if changed {
            self.edited();
        }
        ui.separator();
        ui.checkbox(&mut self.show_handles, "handles (H)");
        if ui.button("save lights (Ctrl+L)").clicked() {
            self.save_lights();
        }
        ui.separator();
        self.path_panel(ui);
    }

    /// A light of this kind where the camera looks, about as bright as daylight indoors.
    fn new_light(&self, kind: Kind) -> Light {
        let extent = self.extent();
        let (right, up, distance) = control::axes(&self.camera);
        let forward = (self.camera.target - self.camera.eye).normalize_or(Vec3::NEG_Z);
        let position = self.camera.eye + forward * (0.6 * distance) + up * (0.1 * extent) + right * (0.05 * extent);
        let (color, direction) = (Vec3::ONE, (self.camera.target - position).normalize_or(Vec3::NEG_Y));
        // π lux at half the extent.
        let intensity = std::f32::consts::PI * (0.5 * extent).powi(2);
        let radius = 0.05 * extent;
        match kind {
            Kind::Spot => Light::Spot {
                position,
                direction,
                color,
                intensity,
                range: None,
                inner_cone_angle: 0.3,
                outer_cone_angle: 0.5,
            },
            Kind::Directional => {
                Light::Directional { direction: Vec3::new(-0.4, -0.8, -0.45).normalize(), color, intensity: 3.0 }
            }
            Kind::Rect => {
                let size = [2.0 * radius, 2.0 * radius];
                Light::Rect { position, direction, up: Vec3::Y, size, color, radiance: intensity / (size[0] * size[1]) }
            }
            Kind::Disk => {
                let area = std::f32::consts::PI * radius * radius;
                Light::Disk { position, direction, radius, color, radiance: intensity / area }
            }
            Kind::Sphere => {
                let area = std::f32::consts::PI * radius * radius;
                Light::Sphere { position, radius, color, radiance: intensity / area }
            }
            Kind::Sky => Light::Sky(Sky { intensity: 1e-4, ..Sky::at(0.7) }),
            Kind::Emissive => Light::Emissive { scale: 1.0 },
            Kind::Point | Kind::Environment => Light::Point { position, color, intensity, range: None },
        }
    }

    fn view_panel(&mut self, ui: &mut Ui) {
        ui.heading("Light");
        let mut part = self.part;
        ui.horizontal_wrapped(|ui| {
            ui.selectable_value(&mut part, Shown::Full, "sum (1)");
            ui.selectable_value(&mut part, Shown::Direct, "direct (2)");
            ui.selectable_value(&mut part, Shown::Indirect, "indirect (3)");
        });
        if part != self.part {
            self.part = part;
            self.redraw();
        }
        self.novelty(ui);
        ui.separator();
        ui.heading("Sides");
        let mut sides = self.sides;
        if let Some(side) = &mut sides[0] {
            self.side_panel(ui, "left", side);
        }
        let mut split = sides[1].is_some();
        if ui.checkbox(&mut split, "split (X)").changed() {
            self.set_split(split.then_some(What::Picture));
            sides[1] = self.sides[1];
        }
        if let Some(side) = &mut sides[1] {
            self.side_panel(ui, "right", side);
            ui.add(Slider::new(&mut self.look.split, 0.02..=0.98).show_value(false).text("split"));
        }
        if sides != self.sides {
            self.sides = sides;
            self.relight();
        }
        if !self.wants_reference() {
            self.reference.stop();
        }
        ui.separator();
        ui.heading("Picture");
        let mut stops = self.look.exposure.max(1e-12).log2();
        if ui.add(Slider::new(&mut stops, -16.0..=16.0).text("exposure, stops")).changed() {
            self.look.exposure = stops.exp2();
        }
        ui.horizontal(|ui| {
            ui.checkbox(&mut self.look.tone_curve, "tone curve");
            if ui.button("expose").clicked() {
                self.expose_anew();
            }
        });
        if self.sides.iter().flatten().any(|side| side.what == What::Difference) {
            let mut stops = self.look.difference.max(1e-12).log2();
            if ui.add(Slider::new(&mut stops, -16.0..=16.0).text("difference, stops")).changed() {
                self.look.difference = stops.exp2();
            }
        }
        ui.separator();
        ui.checkbox(&mut self.show_points, "measurement points (P)");
        ui.checkbox(&mut self.show_basis, "basis elements (B)");
        ui.checkbox(&mut self.show_timings, "timings (T)");
        ui.separator();
        if ui.button("save picture (Ctrl+S)").clicked() {
            self.save_picture();
        }
        if ui.button("first view (F)").clicked() {
            self.camera = self.home.clone();
            self.redraw();
        }
        ui.checkbox(&mut self.help, "help (?)");
    }

    fn side_panel(&self, ui: &mut Ui, name: &str, side: &mut Side) {
        ui.push_id(name, |ui| {
            ui.label(RichText::new(name).strong());
            ui.horizontal_wrapped(|ui| {
                ui.selectable_value(&mut side.what, What::Picture, "relit");
                ui.selectable_value(&mut side.what, What::Reference, "reference");
                ui.selectable_value(&mut side.what, What::Difference, "difference");
            });
            if side.what == What::Reference {
                return;
            }
            if self.names.len() > 1 {
                egui::ComboBox::from_id_salt("model").selected_text(&self.names[side.model]).show_ui(ui, |ui| {
                    for (i, name) in self.names.iter().enumerate() {
                        if ui.selectable_value(&mut side.model, i, name).clicked() {
                            side.elements = self.screen.model(i).transfer.elements;
                        }
                    }
                });
            }
            let model = self.screen.model(side.model);
            match &model.basis.anchors {
                Some(anchors) => {
                    ui.label(format!("{} channels a texel, {} anchors", model.basis.elements, anchors.count));
                }
                None => {
                    let most = model.transfer.elements;
                    ui.add(Slider::new(&mut side.elements, 1..=most).text("elements"));
                }
            }
        });
    }

    /// How far the light is from what the model was trained on.
    fn novelty(&self, ui: &mut Ui) {
        let model = self.screen.model(self.sides[0].map_or(0, |side| side.model));
        let Some(scope) = model.scope.as_ref().filter(|scope| scope.points == self.direct.len()) else { return };
        let Some(reading) = scope.read(&self.direct) else { return };
        let colour = if reading.novelty < 0.5 { Color32::from_rgb(0, 158, 115) } else { Color32::from_rgb(213, 94, 0) };
        let bar = egui::ProgressBar::new(reading.novelty).fill(colour).text("novelty of the light");
        ui.add(bar).on_hover_text(reading.verdict());
        ui.label(reading.verdict());
    }

    fn timings(&mut self, ui: &mut Ui) {
        let history = &self.pace.history;
        let line = |name: &str, value: &dyn Fn(&super::pace::FrameTime) -> Option<f64>| {
            let points: Vec<[f64; 2]> =
                history.iter().enumerate().filter_map(|(i, frame)| Some([i as f64, value(frame)?])).collect();
            Line::new(name.to_owned(), PlotPoints::from(points))
        };
        type OfPass = fn(&crate::gpu::PassTimes) -> f64;
        let passes: [(&str, OfPass); 6] = [
            ("measure", |p| p.measure),
            ("downsample", |p| p.downsample),
            ("transfer", |p| p.transfer),
            ("reconstruct", |p| p.reconstruct),
            ("shade", |p| p.shade),
            ("resolve", |p| p.resolve),
        ];
        Plot::new("timings")
            .legend(Legend::default().position(egui_plot::Corner::LeftTop))
            .x_axis_label("frame")
            .y_axis_label("milliseconds")
            .include_y(0.0)
            .show(ui, |plot| {
                plot.line(line("frame", &|frame| Some(frame.total)));
                for (name, of) in passes {
                    plot.line(line(name, &|frame| Some(of(frame.passes.as_ref()?) * 1e-3)));
                }
            });
    }

    /// One element over the lightmap: red positive, blue negative.
    fn basis_window(&mut self, context: &egui::Context) {
        let index = self.sides[0].map_or(0, |side| side.model);
        let basis = &self.screen.model(index).basis;
        let (mut open, mut element) = (self.show_basis, self.element.min(basis.elements - 1));
        if open && self.element_texture.as_ref().is_none_or(|(m, e, _)| (*m, *e) != (index, element)) {
            let pixels = crate::report::pictures::element_pixels(basis, element);
            let image = egui::ColorImage::from_rgb([basis.size; 2], pixels.as_flattened());
            let texture = context.load_texture("basis", image, egui::TextureOptions::NEAREST);
            self.element_texture = Some((index, element, texture));
        }
        let window = egui::Window::new("Basis").open(&mut open).default_pos(self.corner).default_width(300.0);
        window.show(context, |ui| {
            let what = if basis.anchors.is_some() { "channel" } else { "element" };
            ui.add(
                Slider::new(&mut element, 0..=basis.elements - 1)
                    .text(what)
                    .custom_formatter(|v, _| format!("{}", v + 1.0)),
            );
            if let Some((.., texture)) = &self.element_texture {
                ui.add(egui::Image::new(texture).fit_to_exact_size(egui::vec2(280.0, 280.0)));
            }
        });
        (self.show_basis, self.element) = (open, element);
    }
}

/// The parts of a light. Returns whether one was changed.
fn edit(ui: &mut Ui, light: &mut Light, extent: f32) -> bool {
    let before = light.clone();
    let vector = |ui: &mut Ui, name: &str, v: &mut Vec3, speed: f32| {
        ui.label(name);
        ui.horizontal(|ui| {
            v.as_mut().iter_mut().for_each(|c| _ = ui.add(DragValue::new(c).speed(speed).max_decimals(3)));
        });
    };
    let angle = |ui: &mut Ui, name: &str, value: &mut f32, most: f32| {
        let mut degrees = value.to_degrees();
        if ui.add(Slider::new(&mut degrees, 0.0..=most).text(name).suffix("°").max_decimals(1)).changed() {
            *value = degrees.to_radians();
        }
    };
    ui.label(RichText::new(light.kind().name()).strong());
    if let Some(color) = light.color_mut() {
        ui.horizontal(|ui| {
            ui.color_edit_button_rgb(color.as_mut());
            ui.label("colour");
        });
    }
    let (amount, unit) = light.amount_mut();
    let speed = (*amount * 0.01).max(1e-6);
    ui.horizontal(|ui| {
        ui.add(DragValue::new(amount).speed(speed).range(0.0..=f32::MAX).suffix(format!(" {unit}")));
        if ui.small_button("½").clicked() {
            *amount *= 0.5;
        }
        if ui.small_button("2").clicked() {
            *amount *= 2.0;
        }
    });
    if let Some(position) = light.position_mut() {
        vector(ui, "position, m", position, 0.005 * extent);
    }
    if let Some(direction) = light.direction_mut() {
        let mut to = *direction;
        vector(ui, "direction", &mut to, 0.01);
        if let Some(unit) = to.try_normalize().filter(|_| to != *direction) {
            *direction = unit;
        }
    }
    let length = |ui: &mut Ui, name: &str, value: &mut f32| {
        let range = 1e-4 * extent..=extent;
        ui.add(DragValue::new(value).speed(0.002 * extent).range(range).prefix(format!("{name} ")).suffix(" m"));
    };
    match light {
        Light::Spot { inner_cone_angle, outer_cone_angle, .. } => {
            angle(ui, "outer cone", outer_cone_angle, 90.0);
            angle(ui, "inner cone", inner_cone_angle, 90.0);
            *outer_cone_angle = outer_cone_angle.max(0.01);
            *inner_cone_angle = inner_cone_angle.min(*outer_cone_angle);
        }
        Light::Rect { size, .. } => {
            length(ui, "width", &mut size[0]);
            length(ui, "height", &mut size[1]);
        }
        Light::Disk { radius, .. } | Light::Sphere { radius, .. } => length(ui, "radius", radius),
        Light::Environment { rotation, .. } => angle(ui, "rotation", rotation, 360.0),
        Light::Sky(sky) => {
            angle(ui, "sun's height", &mut sky.sun_elevation, 90.0);
            angle(ui, "sun's compass", &mut sky.sun_azimuth, 360.0);
            ui.add(Slider::new(&mut sky.turbidity, 1.7..=10.0).text("haze"));
        }
        _ => {}
    }
    *light != before
}
