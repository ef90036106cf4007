//! The state of the window, and what a change of it sets off.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use eframe::egui::{self, CentralPanel, Frame, Key, PointerButton, Pos2, Rect, Sense, Ui, vec2};
use eframe::egui_wgpu::RenderState;
use glam::{Vec2, Vec3};

use super::display::{Look, What};
use super::handles::{Eyepiece, Handle};
use super::pace::{Grain, Pace};
use super::player::Player;
use super::reference::Reference;
use super::screen::{Screen, Side};
use super::{Opening, control};
use crate::gpu::GpuError;
use crate::light::{EnvironmentImages, Light};
use crate::math::Rgb;
use crate::model::{Shown, View};
use crate::report::pictures;
use crate::scene::{Camera, Tracer};

/// After this long without a change the picture is drawn finely and the reference begun.
const SETTLED: Duration = Duration::from_millis(200);

pub struct App<'a> {
    pub(super) names: Vec<String>,
    pub(super) screen: Screen<'a>,
    pub(super) tracer: &'a Tracer<'a>,
    pub(super) reference: Reference,
    pub(super) stem: PathBuf,
    pub(super) images: EnvironmentImages,

    pub(super) lights: Vec<Light>,
    pub(super) selected: Option<usize>,
    pub(super) camera: Camera,
    pub(super) home: Camera,
    pub(super) sides: [Option<Side>; 2],
    pub(super) part: Shown,
    pub(super) look: Look,
    /// The first picture decides the exposure.
    exposed: bool,
    pub(super) show_points: bool,
    pub(super) show_handles: bool,
    pub(super) show_timings: bool,
    pub(super) show_basis: bool,
    pub(super) help: bool,
    /// Where windows open.
    pub(super) corner: Pos2,
    /// What had the keys a frame ago.
    pub(super) focused: Option<egui::Id>,
    /// The element that the basis window shows, and its picture.
    pub(super) element: usize,
    pub(super) element_texture: Option<(usize, usize, egui::TextureHandle)>,
    pub(super) player: Player,

    /// As it was measured last.
    pub(super) direct: Vec<Rgb>,
    pub(super) pace: Pace,
    pub(super) reference_paths: u32,
    pub(super) message: String,
    pub(super) failure: Option<String>,

    drag: Drag,
    extent: f32,
    lights_changed: bool,
    view_changed: bool,
    /// What is on the screen.
    pub(super) view: Option<View>,
    drawn: Option<Grain>,
    changed_at: Instant,
    asked: bool,
    saved: u32,
}

/// What the pointer holds.
#[derive(Clone, Copy, PartialEq)]
enum Drag {
    Nothing,
    Camera,
    Light(Handle),
    Split,
}

impl<'a> App<'a> {
    pub fn new(opening: Opening<'a>, tracer: &'a Tracer<'a>, window: RenderState, reference: Reference) -> Self {
        let models: Vec<_> = opening.models.iter().map(|(_, model)| model).collect();
        let elements = models[0].transfer.elements;
        let extent = models[0].asset.mesh.bounds().diagonal();
        let selected = (!opening.lights.is_empty()).then_some(0);
        let mut player = Player::default();
        opening.path.into_iter().for_each(|path| player.open(path));
        Self {
            names: opening.models.iter().map(|(name, _)| name.clone()).collect(),
            screen: Screen::new(window, models),
            tracer,
            reference,
            stem: opening.stem,
            images: EnvironmentImages::default(),
            lights: opening.lights,
            selected,
            home: opening.camera.clone(),
            camera: opening.camera,
            sides: [Some(Side { what: What::Picture, model: 0, elements }), None],
            part: Shown::Full,
            look: Look { exposure: 1.0, tone_curve: true, difference: 1.0, split: 0.5 },
            exposed: false,
            show_points: false,
            show_handles: true,
            show_timings: false,
            show_basis: false,
            help: false,
            corner: Pos2::ZERO,
            focused: None,
            element: 0,
            element_texture: None,
            player,
            direct: Vec::new(),
            pace: Pace::default(),
            reference_paths: 0,
            message: "press ? for help".into(),
            failure: None,
            drag: Drag::Nothing,
            extent,
            lights_changed: true,
            view_changed: true,
            view: None,
            drawn: None,
            changed_at: Instant::now(),
            asked: false,
            saved: 0,
        }
    }

    pub(super) fn centre(&self) -> Vec3 {
        self.tracer.asset().mesh.bounds().centre()
    }

    pub(super) fn extent(&self) -> f32 {
        self.extent
    }

    /// Lights, or what relights, changed.
    pub(super) fn relight(&mut self) {
        self.lights_changed = true;
        self.redraw();
    }

    /// Somebody changed the lights.
    pub(super) fn edited(&mut self) {
        self.player.edited();
        self.relight();
    }

    /// Camera, size or part changed.
    pub(super) fn redraw(&mut self) {
        self.view_changed = true;
        self.changed_at = Instant::now();
        self.asked = false;
    }

    pub(super) fn wants_reference(&self) -> bool {
        self.sides.iter().flatten().any(|side| side.what != What::Picture)
    }

    pub(super) fn next_file(&mut self, suffix: &str) -> PathBuf {
        loop {
            self.saved += 1;
            let path = PathBuf::from(format!("{}-{:03}.{suffix}", self.stem.display(), self.saved));
            if !path.exists() {
                return path;
            }
        }
    }

    /// Brings the picture up to date; returns it.
    fn picture(&mut self, context: &egui::Context, size: [u32; 2]) -> Result<egui::TextureId, GpuError> {
        if self.view.as_ref().is_none_or(|view| [view.width, view.height] != size) {
            self.redraw();
            self.view = Some(View::new(self.camera.clone(), size[0], size[1]));
        }
        if std::mem::take(&mut self.lights_changed) {
            for (at, side) in self.sides.into_iter().enumerate() {
                if let Some(side) = side {
                    let direct = self.screen.relight(at, side, &self.lights)?;
                    if at == 0 {
                        self.direct = direct;
                    }
                }
            }
        }
        let moving = self.changed_at.elapsed() < SETTLED;
        let grain = self.pace.grain(size, moving);
        let finer = |drawn: &Grain| grain.samples() > 1.5 * drawn.samples();
        if std::mem::take(&mut self.view_changed) || (!moving && self.drawn.as_ref().is_none_or(finer)) {
            self.draw(grain)?;
            self.drawn = Some(grain);
            // What this frame took may allow a finer one.
            context.request_repaint();
        }
        if moving {
            context.request_repaint_after(SETTLED.saturating_sub(self.changed_at.elapsed()) + Duration::from_millis(5));
        } else if self.wants_reference() && !std::mem::replace(&mut self.asked, true) {
            self.reference_paths = 0;
            // A quarter of the pixels shows what is to be seen four times as soon.
            let view = View::new(self.camera.clone(), size[0].div_ceil(2), size[1].div_ceil(2));
            self.reference.ask(view, &self.lights);
        }
        if let Some(traced) = self.reference.take() {
            self.reference_paths = traced.paths;
            self.screen.set_reference(Some(traced));
        }
        Ok(self.screen.compose(size, self.sides, &self.look, self.part))
    }

    fn draw(&mut self, grain: Grain) -> Result<(), GpuError> {
        let [width, height] = grain.size;
        let mut view = View::new(self.camera.clone(), width, height);
        view.samples_per_axis = grain.samples_per_axis;
        let (mut took, mut sides) = (Duration::ZERO, 0);
        for (at, side) in self.sides.into_iter().enumerate() {
            if let Some(side) = side.filter(|side| side.what != What::Reference || at == 0) {
                took += self.screen.draw(at, side, &view, self.part)?;
                sides += 1;
            }
        }
        let passes = if self.show_timings { self.screen.pass_times()? } else { None };
        self.pace.drew(grain, sides, took, passes);
        if !std::mem::replace(&mut self.exposed, true) {
            self.expose(&view)?;
        }
        Ok(())
    }

    /// Sets the exposure by the present picture.
    fn expose(&mut self, view: &View) -> Result<(), GpuError> {
        if let Some(picture) = self.screen.picture(view)? {
            self.look.exposure = pictures::exposure_for(&picture);
            self.look.difference = 0.25 / self.look.exposure;
        }
        Ok(())
    }

    pub(super) fn expose_anew(&mut self) {
        self.exposed = false;
        self.redraw();
    }

    fn viewport(&mut self, ui: &mut Ui) {
        let (response, painter) = ui.allocate_painter(ui.available_size(), Sense::click_and_drag());
        let (rect, scale) = (response.rect, ui.ctx().pixels_per_point());
        let size = [rect.width(), rect.height()].map(|points| ((points * scale).round() as u32).max(1));
        let Some(eyepiece) = Eyepiece::new(&self.camera, rect, self.centre(), self.extent) else { return };
        self.point(ui, &response, &eyepiece, rect);
        self.fly(ui, &response);
        if self.player.playing {
            self.play(ui);
        }
        match self.picture(ui.ctx(), size) {
            Ok(texture) => {
                let whole = Rect::from_min_max(Pos2::ZERO, Pos2::new(1.0, 1.0));
                painter.image(texture, rect, whole, egui::Color32::WHITE);
            }
            Err(error) => self.failure = Some(error.to_string()),
        }
        if self.show_points {
            self.paint_points(&painter, &eyepiece);
        }
        if self.show_handles {
            eyepiece.paint(&painter, &self.lights, self.selected);
        }
        self.paint_split(&painter, rect);
    }

    fn split_x(&self, rect: Rect) -> f32 {
        rect.left() + self.look.split * rect.width()
    }

    /// What the pointer does in the scene.
    fn point(&mut self, ui: &Ui, response: &egui::Response, eyepiece: &Eyepiece, rect: Rect) {
        let near_split = |app: &Self, at: Pos2| app.sides[1].is_some() && (at.x - app.split_x(rect)).abs() < 6.0;
        let handle_at = |app: &Self, at: Pos2| {
            app.show_handles.then(|| eyepiece.handle_at(at, &app.lights, app.selected)).flatten()
        };
        if let Some(at) = response.hover_pos()
            && self.drag == Drag::Nothing
        {
            if handle_at(self, at).is_some() {
                ui.ctx().set_cursor_icon(egui::CursorIcon::Grab);
            } else if near_split(self, at) {
                ui.ctx().set_cursor_icon(egui::CursorIcon::ResizeHorizontal);
            }
        }
        if response.drag_started()
            && let Some(at) = ui.input(|i| i.pointer.press_origin())
        {
            let primary = response.drag_started_by(PointerButton::Primary);
            self.drag = match handle_at(self, at).filter(|_| primary) {
                Some(handle) => Drag::Light(handle),
                None if primary && near_split(self, at) => Drag::Split,
                None => Drag::Camera,
            };
            if let Drag::Light(handle) = self.drag {
                self.selected = Some(handle.light());
            }
        }
        if response.dragged()
            && let Some(to) = response.interact_pointer_pos()
        {
            let moved = response.drag_delta();
            match self.drag {
                Drag::Light(handle) if moved != egui::Vec2::ZERO => {
                    let surface_at = |ray| self.surface_at(eyepiece.eye(), ray);
                    // It may have been removed by a key meanwhile.
                    if let Some(mut light) = self.lights.get(handle.light()).cloned() {
                        eyepiece.drag(handle, &mut light, to - moved, to, surface_at);
                        self.lights[handle.light()] = light;
                        self.edited();
                    }
                }
                Drag::Split => self.look.split = ((to.x - rect.left()) / rect.width()).clamp(0.02, 0.98),
                Drag::Camera if moved != egui::Vec2::ZERO => {
                    let share = Vec2::new(moved.x, moved.y) / rect.height();
                    let shift = ui.input(|i| i.modifiers.shift);
                    if response.dragged_by(PointerButton::Middle) || shift {
                        control::pan(&mut self.camera, share);
                    } else if response.dragged_by(PointerButton::Secondary) {
                        control::look(&mut self.camera, share * 2.0);
                    } else {
                        control::orbit(&mut self.camera, share * 4.0);
                    }
                    self.redraw();
                }
                _ => {}
            }
        }
        if response.drag_stopped() {
            self.drag = Drag::Nothing;
        }
        if response.clicked()
            && let Some(at) = response.interact_pointer_pos()
        {
            self.selected = handle_at(self, at).map(Handle::light);
        }
        if response.double_clicked()
            && let Some(at) = response.interact_pointer_pos()
            && let Some(target) = self.surface_at(eyepiece.eye(), eyepiece.ray(at))
        {
            self.camera.target = target;
            self.redraw();
        }
        let scroll = ui.input(|i| i.smooth_scroll_delta().y + 200.0 * (i.zoom_delta() - 1.0));
        if response.hovered() && scroll != 0.0 {
            control::zoom(&mut self.camera, (scroll * 0.004).exp(), 1e-3 * self.extent);
            self.redraw();
        }
    }

    /// The surface that a ray meets.
    fn surface_at(&self, eye: Vec3, ray: Vec3) -> Option<Vec3> {
        crate::model::render::first_visible(self.tracer, eye, ray).map(|hit| eye + ray * hit.t)
    }

    /// W A S D Q E while the pointer is over the scene.
    fn fly(&mut self, ui: &Ui, response: &egui::Response) {
        if !response.hovered() || ui.ctx().egui_wants_keyboard_input() {
            return;
        }
        let (by, seconds) = ui.input(|i| {
            let axis = |plus: Key, minus: Key| i.key_down(plus) as i32 as f32 - i.key_down(minus) as i32 as f32;
            let free = if i.modifiers.any() { 0.0 } else { 1.0 };
            (Vec3::new(axis(Key::D, Key::A), axis(Key::E, Key::Q), axis(Key::W, Key::S)) * free, i.stable_dt.min(0.1))
        });
        if by != Vec3::ZERO {
            control::fly(&mut self.camera, by * seconds * 0.5 * self.extent);
            self.redraw();
            ui.ctx().request_repaint();
        }
    }

    fn paint_split(&self, painter: &egui::Painter, rect: Rect) {
        if self.sides[1].is_none() {
            return;
        }
        let x = self.split_x(rect);
        let line = [Pos2::new(x, rect.top()), Pos2::new(x, rect.bottom())];
        painter.line_segment(line, egui::Stroke::new(2.0, egui::Color32::WHITE));
        let (left, right) = (self.side_name(0), self.side_name(1));
        let text = |at: Pos2, align, text: String| {
            let font = egui::FontId::proportional(13.0);
            let galley = painter.layout_no_wrap(text, font, egui::Color32::WHITE);
            let place = egui::Align2::anchor_size(align, at, galley.size());
            painter.rect_filled(place.expand(3.0), 3.0, egui::Color32::from_black_alpha(150));
            painter.galley(place.min, galley, egui::Color32::WHITE);
        };
        text(Pos2::new(x - 8.0, rect.top() + 8.0), egui::Align2::RIGHT_TOP, left);
        text(Pos2::new(x + 8.0, rect.top() + 8.0), egui::Align2::LEFT_TOP, right);
    }

    /// The measurement points that are in sight, in the colour of their light.
    fn paint_points(&self, painter: &egui::Painter, eyepiece: &Eyepiece) {
        let points = &self.screen.model(self.sides[0].map_or(0, |side| side.model)).points.points;
        for (point, &x) in points.iter().zip(&self.direct) {
            let position = point.position + point.normal * (2e-3 * self.extent);
            let (to_eye, from_eye) = (eyepiece.eye() - position, position - eyepiece.eye());
            if to_eye.dot(point.normal) <= 0.0 {
                continue;
            }
            let distance = from_eye.length();
            let hidden = crate::model::render::first_visible(self.tracer, eyepiece.eye(), from_eye / distance)
                .is_some_and(|hit| hit.t < distance * 0.995);
            if let Some(at) = eyepiece.to_screen(position).filter(|_| !hidden) {
                let [r, g, b] = crate::math::colour::srgb8_from_linear(crate::math::colour::tone_map(
                    x * std::f32::consts::FRAC_1_PI * self.look.exposure,
                ));
                let outline = egui::Stroke::new(1.0, egui::Color32::from_gray(200));
                painter.circle(at, 3.5, egui::Color32::from_rgb(r, g, b), outline);
            }
        }
    }
}

impl eframe::App for App<'_> {
    fn ui(&mut self, ui: &mut Ui, _frame: &mut eframe::Frame) {
        self.keys(ui);
        self.dropped(ui);
        self.panels(ui);
        CentralPanel::default().frame(Frame::NONE).show(ui, |ui| {
            if ui.available_size().min_elem() > 1.0 {
                self.viewport(ui);
            } else {
                ui.allocate_space(vec2(1.0, 1.0));
            }
        });
    }
}
