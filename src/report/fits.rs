//! Fits of all methods and sizes to one training set.

use glam::Vec3;

use super::assemble::ReportError;
use super::cost::Cost;
use super::temporal::Measured;
use crate::dataset::{Bytes, Dataset, OF_SCENARIO, Unbaked};
use crate::light::Scenario;
use crate::model::{Basis, Channels, Transfer};
use crate::progress::Progress;
use crate::scene::{Finish, Lightmap};
use crate::transfer::{
    self, Extent, Fit, Gram, Lambda, LocalFit, Method, PUBLISHED_LAMBDA, Precision, Prior, PriorSums, Spectrum, Terms,
    Tested, TrainSettings, TransferError,
};
use crate::transport::{Adjoint, BakeSettings};

/// Basis sizes that are compared: the paper's 4, 16 and 64 and those between.
pub const SIZES: [usize; 5] = [4, 8, 16, 32, 64];

/// Channels a texel of local bases that are compared.
pub const LOCAL_SIZES: [usize; 4] = [2, 4, 8, 16];

/// What is fitted, to whatever training set.
#[derive(Clone, Copy)]
pub struct Recipe<'r> {
    pub channels: Channels,
    /// λ given by the user for every fit, relative.
    pub lambda: Option<f64>,
    /// Position and normal of each texel.
    pub places: &'r [(Vec3, Vec3)],
    /// Anchors of local bases, and how their channels are stored.
    pub anchors: usize,
    pub precision: Precision,
    /// Sizes of global bases and of local ones.
    pub sizes: &'r [usize],
    pub local_sizes: &'r [usize],
    /// Whether the baseline is fitted with the λ that leave-one-out finds, too, which is better than the paper's.
    pub better_baseline: bool,
    /// Side of the lightmap, texels.
    pub lightmap_size: usize,
    /// Ceiling of the process's resident memory: local bases that do not fit are left out.
    pub memory: Bytes,
    /// Where what `linear` and `local` know beforehand comes from; none where they learn all from lightmaps.
    pub prior: Option<PriorSource<'r>>,
}

/// What tells a transfer before any lightmap is looked at.
#[derive(Clone, Copy)]
pub struct PriorSource<'r> {
    /// That the training set is drawn from.
    pub scenario: &'r Scenario,
    pub lightmap: &'r Lightmap,
    pub bake: BakeSettings,
}

impl PriorSource<'_> {
    fn prior(
        &self,
        fit: &Fit,
        Measured { dataset, points, tracer }: Measured,
        progress: &dyn Progress,
    ) -> Result<Prior, ReportError> {
        let adjoint = Adjoint::new(tracer, self.lightmap, points, self.bake);
        let mut sums = PriorSums::new(fit, dataset, &adjoint, progress)?;
        let unbaked = Unbaked { tracer, points, scenario: self.scenario, seed: self.bake.seed, own: OF_SCENARIO };
        unbaked.for_each(&mut |measured| sums.add(measured))?;
        Ok(sums.finish()?)
    }
}

/// Which fit it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Label {
    /// belcour, linear or local.
    pub method: &'static str,
    /// Elements; channels a texel of a local basis.
    pub size: usize,
    /// How λ was chosen: `published`, `leave-one-out` or `given`.
    pub lambda_choice: &'static str,
}

/// One fit.
pub struct Fitted {
    pub label: Label,
    /// Relative.
    pub lambda: f64,
    pub cost: Cost,
    pub basis: Kind,
}

/// Its basis.
pub enum Kind {
    Global(Fit),
    Local(LocalFit),
}

/// All fits to one training set.
pub struct Fits {
    pub list: Vec<Fitted>,
    channels: Channels,
    /// Of the local ones.
    terms: Option<Terms>,
}

impl<'r> Recipe<'r> {
    /// The same for another scenario.
    pub fn under(self, scenario: &'r Scenario) -> Self {
        Self { prior: self.prior.map(|source| PriorSource { scenario, ..source }), ..self }
    }

    /// The same with one size of each: for figures over something else than sizes.
    pub fn one_size(self, sizes: &'r [usize], local_sizes: &'r [usize]) -> Self {
        Self { sizes, local_sizes, better_baseline: false, ..self }
    }

    /// Whether a local basis of `channels` a texel fits into the ceiling of memory.
    fn fits_memory(&self, Measured { dataset, points, .. }: Measured, channels: usize) -> bool {
        let needed = transfer::bytes_needed(&Extent {
            method: Method::Local,
            channels: self.channels,
            elements: channels,
            anchors: self.anchors,
            training: dataset.training,
            conditions: dataset.conditions.len(),
            points: dataset.points(),
            sub_points: if self.prior.is_some() { points.sub_points.len() } else { 0 },
            texels: dataset.texels(),
            lightmap_size: self.lightmap_size,
            raised: false,
        });
        Bytes::resident().0 + needed <= self.memory.0
    }

    /// Fits everything. Sizes that the training set does not allow are left out, and so are local bases that do not fit into memory,
    /// which is told.
    ///
    /// # Errors
    /// When a fit fails, the dataset cannot be read, or `progress` cancels.
    pub fn fit(&self, set: Measured, gram: &Gram, progress: &dyn Progress) -> Result<Fits, ReportError> {
        let dataset = set.dataset;
        let mut list = Vec::new();
        let settings = |method, elements, lambda| TrainSettings { method, channels: self.channels, elements, lambda };
        let published = (PUBLISHED_LAMBDA, "published");
        let found = match self.lambda {
            Some(value) => (Lambda::Relative(value), "given"),
            None => (Lambda::LeaveOneOut, "leave-one-out"),
        };
        let baseline = match (self.lambda, self.better_baseline) {
            (Some(_), _) => vec![found],
            (None, true) => vec![published, found],
            (None, false) => vec![published],
        };
        let mut terms = None;
        for (method, choices) in [(Method::Belcour, baseline), (Method::Linear, vec![found])] {
            let spectrum = match Spectrum::of(dataset, gram, settings(method, 1, found.0)) {
                Err(TransferError::TooFewConditions { .. }) => continue,
                other => other?,
            };
            let source = self.prior.filter(|_| method != Method::Belcour);
            let all_terms = || spectrum.fit(settings(Method::Local, 1, found.0));
            let prior = source.map(|source| source.prior(&all_terms()?, set, progress)).transpose()?;
            let told = |fit: Fit| match &prior {
                Some(prior) => fit.with_prior(dataset, prior),
                None => Ok(fit),
            };
            for (lambda, lambda_choice) in choices {
                for &size in self.sizes {
                    match spectrum.fit(settings(method, size, lambda)).and_then(told) {
                        Ok(fit) => list.push(Fitted {
                            label: Label { method: method.name(), size, lambda_choice },
                            lambda: fit.lambda,
                            cost: Cost::global(self.channels, size, dataset.points(), self.lightmap_size),
                            basis: Kind::Global(fit),
                        }),
                        // A training set smaller than the size has no such fit.
                        Err(TransferError::TooFewConditions { .. }) => break,
                        Err(error) => return Err(error.into()),
                    }
                }
            }
            let (fitting, over): (Vec<usize>, Vec<usize>) =
                self.local_sizes.iter().partition(|&&size| self.fits_memory(set, size));
            if method == Method::Belcour || self.local_sizes.is_empty() {
                continue;
            }
            if let Some(size) = over.first() {
                progress.note(&format!(
                    "local bases of {size} channels a texel and more would not fit into --memory and are not compared"
                ));
            }
            if fitting.is_empty() {
                continue;
            }
            let fit = told(all_terms()?)?;
            let of_fit = Terms::new(&fit, dataset, self.places, self.anchors, progress)?;
            for size in fitting {
                let local = LocalFit::train(&of_fit, size, self.precision);
                let bytes = local.bytes_per_texel(self.channels);
                list.push(Fitted {
                    label: Label { method: "local", size, lambda_choice: found.1 },
                    lambda: fit.lambda,
                    cost: Cost::local(self.channels, size, bytes, self.anchors, dataset.points(), self.lightmap_size),
                    basis: Kind::Local(local),
                });
            }
            terms = Some(of_fit);
        }
        Ok(Fits { list, channels: self.channels, terms })
    }
}

impl Fits {
    /// The fit of `method` and size with the first choice of λ, if it was made.
    pub fn find(&self, method: &str, size: usize) -> Option<&Fitted> {
        self.list.iter().find(|f| f.label.method == method && f.label.size == size)
    }

    /// Basis over the page and transfer, as a model has them.
    ///
    /// # Errors
    /// When `dataset`, the one that was fitted to, cannot be read, or `progress` cancels.
    pub fn model(
        &self,
        fitted: &Fitted,
        dataset: &Dataset,
        finish: &Finish,
        progress: &dyn Progress,
    ) -> Result<(Basis, Transfer), TransferError> {
        match (&fitted.basis, &self.terms) {
            (Kind::Global(fit), _) => {
                let (values, transfer) = fit.expand(dataset, progress)?;
                Ok((Basis::from_texels(finish, transfer.elements, &values), transfer))
            }
            (Kind::Local(local), Some(terms)) => {
                let basis = local.page(terms, finish.sources(), &|planes| finish.path_traced_pages(planes));
                Ok((basis, local.transfer(terms, self.channels)))
            }
            (Kind::Local(_), None) => unreachable!("local bases are fitted to terms, which are kept"),
        }
    }

    /// A fit, ready to be tested on the held-out conditions of `dataset`, the first conditions of which are those that it was
    /// trained on.
    ///
    /// # Errors
    /// When the dataset cannot be read, or `progress` cancels.
    pub fn test<'t>(
        &'t self,
        fitted: &'t Fitted,
        dataset: &'t Dataset,
        gram: &'t Gram,
        progress: &dyn Progress,
    ) -> Result<Tested<'t>, TransferError> {
        match (&fitted.basis, &self.terms) {
            (Kind::Global(fit), _) => Ok(Tested::global(fit, dataset, gram)),
            (Kind::Local(local), Some(terms)) => Tested::local(local, terms, self.channels, dataset, gram, progress),
            (Kind::Local(_), None) => unreachable!("local bases are fitted to terms, which are kept"),
        }
    }
}
