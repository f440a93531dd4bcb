//! Texts over a panel, mainly the numbers of segments: readable on any colour, without overlap.

use embedded_graphics::prelude::*;
use embedded_graphics::primitives::Rectangle;

use super::canvas::{Canvas, NUMBER, TextStyle, text_width};
use sweepd_core::sweep::layout::LABEL_FIRST_SEGMENT;
use sweepd_core::sweep::{Segment, SweepRef};

/// Pixels between two texts.
const GAP: u32 = 4;

/// Segments whose returns take at least as much area of the label image, of this size, as their
/// numbers; the largest first.
pub fn numbered(sweep: SweepRef<'_>, image: Size) -> Vec<&Segment> {
    let row_height = image.height / (sweep.rows() as u32).max(1);
    let row_pixels = u64::from(image.width) * u64::from(row_height);
    let columns = sweep.columns.len() as u64;
    let mut segments: Vec<&Segment> = sweep.segments.iter().collect();
    segments.retain(|segment| {
        let Size { width, height } = number_size(segment.label);
        u64::from(segment.points) * row_pixels >= u64::from(width * height) * columns
    });
    segments.sort_by_key(|segment| (std::cmp::Reverse(segment.points), segment.label));
    segments
}

/// Place of a label's segment in the table; none for ground and for returns without label.
pub fn entry(label: u32) -> Option<usize> {
    label
        .checked_sub(LABEL_FIRST_SEGMENT)
        .map(|entry| entry as usize)
}

/// Pixels that the number of a segment takes.
pub fn number_size(label: u32) -> Size {
    text_size(&label.to_string(), NUMBER)
}

fn text_size(text: &str, style: TextStyle) -> Size {
    Size::new(text_width(text, style), style.font.character_size.height)
}

/// The texts of a panel.
pub struct Texts {
    area: Rectangle,
    taken: Vec<Rectangle>,
}

impl Texts {
    /// A panel without texts.
    pub fn new(area: Rectangle) -> Self {
        Self {
            area,
            taken: Vec::new(),
        }
    }

    /// Keeps texts away from here.
    pub fn keep_clear(&mut self, area: Rectangle) {
        self.taken.push(area);
    }

    /// Draws the number of a segment around the first of these points with enough room, if any.
    pub fn draw_number(&mut self, page: &mut Canvas, label: u32, centers: &[Point]) {
        let text = label.to_string();
        centers
            .iter()
            .find(|&&center| self.draw(page, center, &text, NUMBER));
    }

    /// Draws a text around a point of the panel, moved into the panel, if there is room; returns
    /// whether it was drawn.
    pub fn draw(&mut self, page: &mut Canvas, center: Point, text: &str, style: TextStyle) -> bool {
        let size = text_size(text, style) + Size::new_equal(GAP);
        let area = self.area;
        let Some(lower_right) = area.bottom_right().filter(|_| area.contains(center)) else {
            return false;
        };
        let most = lower_right + Point::new(1, 1) - size;
        let top_left = (center - size / 2)
            .component_min(most)
            .component_max(area.top_left);
        let place = Rectangle::new(top_left, size);
        let mut meets = self.taken.iter().map(|taken| taken.intersection(&place));
        if !meets.all(|common| common.is_zero_sized()) {
            return false;
        }
        self.taken.push(place);
        page.rimmed_text(top_left + Point::new_equal(GAP as i32 / 2), text, style);
        true
    }
}

#[cfg(test)]
mod tests {
    use embedded_graphics::pixelcolor::Rgb888;

    use super::super::palette::TEXT;
    use super::*;

    /// Pixels of this colour, and of another one than black outside of an area.
    fn pixels(page: &Canvas, area: &Rectangle, color: Rgb888) -> (usize, usize) {
        let everywhere = page.bounding_box();
        let colored = everywhere.points().zip(page.bytes.chunks_exact(3));
        let colored = colored.map(|(at, rgb)| (at, Rgb888::new(rgb[0], rgb[1], rgb[2])));
        let (inside, outside): (Vec<_>, Vec<_>) = colored.partition(|(at, _)| area.contains(*at));
        let count = |points: Vec<(Point, Rgb888)>, is: &dyn Fn(Rgb888) -> bool| {
            points.into_iter().filter(|(_, color)| is(*color)).count()
        };
        (
            count(inside, &|found| found == color),
            count(outside, &|found| found != BLACK),
        )
    }

    const BLACK: Rgb888 = Rgb888::new(0, 0, 0);

    /// Texts that cover each other would show fewer pixels than all of them have.
    #[test]
    fn numbers_do_not_cover_each_other_and_stay_in_their_panel() {
        let area = Rectangle::new(Point::new(20, 10), Size::new(200, 120));
        let blank = || Canvas::new(Size::new(240, 140), BLACK);
        let mut alone = blank();
        assert!(Texts::new(area).draw(&mut alone, area.center(), "88", NUMBER));
        let (one, _) = pixels(&alone, &area, TEXT);
        assert!(one > 60, "{one} pixels of 88");

        let mut random = fastrand::Rng::with_seed(3);
        let (mut page, mut texts, mut drawn) = (blank(), Texts::new(area), 0);
        for _ in 0..1000 {
            let center = Point::new(random.i32(0..240), random.i32(0..140));
            drawn += usize::from(texts.draw(&mut page, center, "88", NUMBER));
        }
        // 9 x 6 would fit side by side.
        assert!((15..=54).contains(&drawn), "{drawn} drawn");
        assert_eq!(pixels(&page, &area, TEXT), (drawn * one, 0));
    }

    #[test]
    fn a_number_goes_to_the_first_place_that_is_free() {
        let area = Rectangle::new(Point::zero(), Size::new(200, 60));
        let (left, right) = (Point::new(40, 30), Point::new(150, 30));
        let half = |center: Point| Rectangle::with_center(center, Size::new(50, 40));
        let (mut page, mut texts) = (Canvas::new(area.size, BLACK), Texts::new(area));
        texts.draw_number(&mut page, 7, &[left, right]);
        assert_eq!(pixels(&page, &half(right), TEXT).0, 0);
        texts.draw_number(&mut page, 7, &[left, right]);
        let (at_left, at_right) = (
            pixels(&page, &half(left), TEXT).0,
            pixels(&page, &half(right), TEXT).0,
        );
        assert!(
            at_left > 10 && at_left == at_right,
            "{at_left} and {at_right} pixels"
        );
        texts.draw_number(&mut page, 7, &[left, right]);
        assert_eq!(pixels(&page, &area, TEXT).0, at_left + at_right);
    }
}
