//! Splats carried along with a surface, and the division of those that are larger than the bend around them.

use super::cloud::{SplatChange, Splats, bytes_of_splat};
use glam::DVec3;
use pliant_exec::Exec;
use pliant_exec::progress::Cancelled;
use pliant_mesh::carry::{CarriedPoints, CarriedSpace, SurfaceCarrier, SurfaceStretch};

/// Splats that are carried before the next ones: what they need besides themselves is held for so many.
const SPLATS_AT_ONCE: usize = 1 << 16;
/// A splat ends so many standard deviations from its centre.
const SPLAT_END: f64 = 2.0;
/// Splats whose half length is below this fraction of the surface's diagonal are not asked whether they should be bent.
const SMALL: f64 = 0.01;
/// A splat is too large where its ends miss the motion around them by more than this fraction of their distance.
const BENT: f64 = 0.25;
/// How many times a splat is divided, and its parts.
const ROUNDS: usize = 3;
/// Divisions end before there are so many times as many splats as in the file, and so many more.
const MOST_GROWTH: usize = 2;
const GROWTH_OF_FEW: usize = 1 << 12;

/// The parts of a divided splat, of which the sum is the whole within 6 % of its peak, and with the same centre and covariance: along
/// its longest axis each is this share as long as the whole,
const PART_LENGTH: f64 = 0.65;
/// the outer two stand so many standard deviations of the whole from its centre,
const PART_OFFSET: f64 = 1.1;
/// and this is how opaque they are beside the whole: weight ÷ length. Both outer weights together are (1 − length²) ÷ offset².
const OUTER: f64 = 0.5 * (1.0 - PART_LENGTH * PART_LENGTH) / (PART_OFFSET * PART_OFFSET) / PART_LENGTH;
const MIDDLE: f64 = 1.0 / PART_LENGTH - 2.0 * OUTER;

/// Where the centres of splats go.
#[derive(Debug, Clone, Copy)]
pub enum SplatPlaces<'a> {
    /// Where the surface carries them.
    Carried,
    /// There, one place for each splat, which a caller has found from the same surface.
    Given(&'a [DVec3]),
}

/// How splats are carried along.
#[derive(Debug, Clone, Copy)]
pub struct SplatMotion<'a> {
    /// Where the centres go.
    pub places: SplatPlaces<'a>,
    /// Whether those that are larger than the bend around them are divided.
    pub divides: bool,
    /// The centres, bound to the surface, where they are.
    pub bound: Option<&'a CarriedPoints>,
}

impl Splats {
    /// Carries them along with a surface, from its rest pose to where it is. What has not moved keeps its bits.
    ///
    /// # Errors
    /// [`Cancelled`]; the splats are of no use then.
    pub fn move_along(
        &mut self,
        carrier: &SurfaceCarrier,
        motion: &SplatMotion<'_>,
        exec: &Exec<'_>,
    ) -> Result<(), Cancelled> {
        let along = CarriedAlong {
            carrier,
            stretch: carrier.stretch(exec.pool),
            bound: motion.bound.filter(|bound| bound.len() == self.len()),
            exec,
        };
        let mut of_given: Vec<u32> = (0..self.len() as u32).collect();
        let mut asked = of_given.clone();
        let most = MOST_GROWTH * self.len() + GROWTH_OF_FEW;
        let mut rounds = if motion.divides { ROUNDS } else { 0 };
        let mut is_first = true;
        loop {
            let bent = along.larger_than_bend(self, &asked, &of_given)?;
            self.bent = bent.len();
            let grown = self.len() + 2 * bent.len();
            let bytes = (self.len() + grown) as u64 * bytes_of_splat(self.coefficients());
            if rounds == 0 || bent.is_empty() || grown > most || !exec.progress.may_hold(bytes) {
                break;
            }
            rounds -= 1;
            let (numbers, parts) = self.divide(&bent);
            of_given = numbers.iter().map(|&k| of_given[k as usize]).collect();
            asked = parts;
            self.divided += if is_first { bent.len() } else { 0 };
            is_first = false;
        }
        let all: Vec<u32> = (0..self.len() as u32).collect();
        for own in all.chunks(SPLATS_AT_ONCE) {
            let mut spaces = along.spaces(self, own, &of_given)?;
            if let SplatPlaces::Given(places) = motion.places {
                for (&number, space) in own.iter().zip(&mut spaces) {
                    let place = places.get(of_given[number as usize] as usize);
                    if let Some(place) = place.filter(|_| self.changes[number as usize] != SplatChange::Divided) {
                        space.frame.position = *place;
                    }
                }
            }
            self.carry(own[0] as usize, &spaces, exec.pool);
        }
        Ok(())
    }

    /// Divides splats, whose numbers rise, into three along their longest axis each. Answers which splat each was, and the numbers of
    /// the parts.
    fn divide(&mut self, bent: &[u32]) -> (Vec<u32>, Vec<u32>) {
        let mut numbers = Vec::with_capacity(self.len() + 2 * bent.len());
        let mut parts = Vec::with_capacity(3 * bent.len());
        let mut next = bent.iter().copied().peekable();
        for splat in 0..self.len() as u32 {
            let count = if next.next_if_eq(&splat).is_some() { 3 } else { 1 };
            if count == 3 {
                parts.extend((0..3).map(|k| numbers.len() as u32 + k));
            }
            numbers.extend(std::iter::repeat_n(splat, count));
        }
        let mut divided = self.kept(&numbers);
        for own in parts.as_chunks::<3>().0 {
            for (&part, place) in own.iter().zip([-1.0, 0.0, 1.0]) {
                divided.make_part(part as usize, place);
            }
        }
        *self = divided;
        (numbers, parts)
    }

    /// Makes of a splat the part of it that stands at −1, 0 or 1 times the offset of parts.
    fn make_part(&mut self, splat: usize, place: f64) {
        let offset = self.longest_axis(splat) * (place * PART_OFFSET);
        self.centers[splat] += offset;
        let log_scale = &mut self.shapes[splat].log_scale;
        let mut longest = 0;
        for axis in 1..3 {
            if log_scale[axis] > log_scale[longest] {
                longest = axis;
            }
        }
        log_scale[longest] += libm::log(PART_LENGTH) as f32;
        let share = if place == 0.0 { MIDDLE } else { OUTER };
        let opacity = &mut self.looks[splat].opacity;
        let opaque = share / (1.0 + libm::exp(-f64::from(*opacity)));
        *opacity = libm::log(opaque / (1.0 - opaque)) as f32;
        self.changes[splat] = SplatChange::Divided;
    }
}

/// What carries splats along.
struct CarriedAlong<'a> {
    carrier: &'a SurfaceCarrier,
    stretch: SurfaceStretch,
    /// The centres that there were at first, bound to the surface.
    bound: Option<&'a CarriedPoints>,
    exec: &'a Exec<'a>,
}

impl CarriedAlong<'_> {
    /// How space has moved around splats of these numbers; `of_given` has the number that each had at first.
    fn spaces(&self, splats: &Splats, numbers: &[u32], of_given: &[u32]) -> Result<Vec<CarriedSpace>, Cancelled> {
        let Self {
            carrier, stretch, exec, ..
        } = self;
        let is_part = |number: u32| splats.changes[number as usize] == SplatChange::Divided;
        let center = |number: u32| splats.centers()[number as usize];
        let Some(bound) = self.bound else {
            let centers: Vec<DVec3> = numbers.iter().map(|&number| center(number)).collect();
            return carrier.carry_spaces(stretch, &centers, exec);
        };
        let whole = numbers.iter().filter(|&&number| !is_part(number));
        let whole: Vec<u32> = whole.map(|&number| of_given[number as usize]).collect();
        let parts = numbers.iter().filter(|&&number| is_part(number));
        let parts: Vec<DVec3> = parts.map(|&number| center(number)).collect();
        let mut whole = bound.spaces_along(&whole, carrier, stretch, exec)?.into_iter();
        let mut parts = carrier.carry_spaces(stretch, &parts, exec)?.into_iter();
        let next = |number: &u32| if is_part(*number) { parts.next() } else { whole.next() };
        Ok(numbers.iter().filter_map(next).collect())
    }

    /// Those of these splats that are larger than the bend around them.
    fn larger_than_bend(&self, splats: &Splats, asked: &[u32], of_given: &[u32]) -> Result<Vec<u32>, Cancelled> {
        let small = SMALL * self.carrier.diagonal();
        let half = |splat: u32| splats.longest_axis(splat as usize) * SPLAT_END;
        let large = asked.iter().copied().filter(|&splat| half(splat).length() > small);
        let large: Vec<u32> = large.collect();
        let mut bent = Vec::new();
        for large in large.chunks(SPLATS_AT_ONCE) {
            let spaces = self.spaces(splats, large, of_given)?;
            let ends = large.iter().flat_map(|&splat| {
                let center = splats.centers()[splat as usize];
                [center + half(splat), center - half(splat)]
            });
            let ends = ends.collect::<Vec<_>>();
            let ends = self.carrier.carry_spaces(&self.stretch, &ends, self.exec)?;
            for ((&splat, space), ends) in large.iter().zip(&spaces).zip(ends.as_chunks::<2>().0) {
                let now = space.gradient * half(splat);
                let miss = |end: &CarriedSpace, offset: DVec3| {
                    let by_place = end.frame.position.distance(space.frame.position + offset);
                    // Offsets of carried points do not shear: where space is stretched and not bent, gradients are the same at both.
                    let by_gradient = 0.5 * ((end.gradient - space.gradient) * half(splat)).length();
                    by_place.min(by_gradient)
                };
                if miss(&ends[0], now).max(miss(&ends[1], -now)) > BENT * now.length() {
                    bent.push(splat);
                }
            }
        }
        Ok(bent)
    }
}
