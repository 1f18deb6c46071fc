//! Films: frames one after the other, in one file.

use std::io::{Read as _, Write as _};
use std::path::Path;
use std::process::{Command, Stdio};

use crate::PictureError;
use crate::format::by_ending;

/// Kind of file that a film is written to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FilmFormat {
    /// 256 colours, for whatever shows pictures.
    Gif,
    /// Small, for pages; the program ffmpeg encodes it.
    Webp,
    /// For slides; the program ffmpeg encodes it.
    Mp4,
}

impl FilmFormat {
    /// The format that a file's ending names.
    ///
    /// # Errors
    /// [`PictureError::Format`] for other endings.
    pub fn from_path(path: &Path) -> Result<Self, PictureError> {
        by_ending(path, &[("gif", FilmFormat::Gif), ("webp", FilmFormat::Webp), ("mp4", FilmFormat::Mp4)])
    }
}

/// Frames of one size.
#[derive(Debug, Clone)]
pub struct Film {
    /// Width in pixels.
    pub width: u16,
    /// Height in pixels.
    pub height: u16,
    /// Frames shown in a second.
    pub frames_per_s: u16,
    /// RGB, 8 bits each, row after row from the upper left.
    pub frames: Vec<Vec<u8>>,
}

impl Film {
    /// The bytes of a file.
    ///
    /// # Errors
    /// [`PictureError::Empty`] without frames, [`PictureError::BufferLength`] for a frame of another size,
    /// [`PictureError::Encode`] with the encoder's message.
    pub fn encode(&self, format: FilmFormat) -> Result<Vec<u8>, PictureError> {
        let expected = usize::from(self.width) * usize::from(self.height) * 3;
        if let Some(frame) = self.frames.iter().find(|frame| frame.len() != expected) {
            return Err(PictureError::BufferLength { expected, actual: frame.len() });
        }
        if self.frames.is_empty() {
            return Err(PictureError::Empty { what: "the film".into() });
        }
        match format {
            FilmFormat::Gif => self.gif(),
            FilmFormat::Webp => self.by_ffmpeg("-c:v libwebp_anim -loop 0 -f webp -"),
            FilmFormat::Mp4 => self.by_ffmpeg("-pix_fmt yuv420p -movflags frag_keyframe+empty_moov -f mp4 -"),
        }
    }

    fn gif(&self) -> Result<Vec<u8>, PictureError> {
        let failed = |error: gif::EncodingError| PictureError::Encode(error.to_string());
        let mut bytes = Vec::new();
        let mut encoder = gif::Encoder::new(&mut bytes, self.width, self.height, &[]).map_err(failed)?;
        encoder.set_repeat(gif::Repeat::Infinite).map_err(failed)?;
        for pixels in &self.frames {
            // the fastest choice of colours: a drawing has few
            let mut frame = gif::Frame::from_rgb_speed(self.width, self.height, pixels, 30);
            frame.delay = 100 / self.frames_per_s;
            encoder.write_frame(&frame).map_err(failed)?;
        }
        drop(encoder);
        Ok(bytes)
    }

    fn by_ffmpeg(&self, output: &str) -> Result<Vec<u8>, PictureError> {
        let failed = |error: std::io::Error| PictureError::Encode(format!("ffmpeg: {error}"));
        let Film { width, height, frames_per_s, .. } = self;
        let input = format!("-f rawvideo -pix_fmt rgb24 -s {width}x{height} -r {frames_per_s} -i -");
        let started = Command::new("ffmpeg")
            .args(["-loglevel", "error"])
            .args(input.split(' '))
            .args(output.split(' '))
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .map_err(|error| {
                PictureError::Encode(format!(
                    "it needs the program ffmpeg ({error}); name a file that ends in .gif"
                ))
            });
        let mut encoder = started?;
        let (stdin, stdout) = (encoder.stdin.take(), encoder.stdout.take());
        let mut bytes = Vec::new();
        std::thread::scope(|scope| {
            // it answers while it reads
            scope.spawn(|| {
                let mut stdin = stdin;
                self.frames
                    .iter()
                    .try_for_each(|frame| stdin.as_mut().map_or(Ok(()), |pipe| pipe.write_all(frame)))
            });
            stdout.map_or(Ok(0), |mut pipe| pipe.read_to_end(&mut bytes))
        })
        .map_err(failed)?;
        let status = encoder.wait().map_err(failed)?;
        if status.success() { Ok(bytes) } else { Err(PictureError::Encode(format!("ffmpeg: {status}"))) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn film() -> Film {
        let frame = |grey: u8| vec![grey; 5 * 3 * 3];
        Film { width: 5, height: 3, frames_per_s: 25, frames: vec![frame(10), frame(200), frame(90)] }
    }

    #[test]
    fn a_gif_is_read_back_frame_by_frame() {
        let bytes = film().encode(FilmFormat::Gif).unwrap();
        let mut options = gif::DecodeOptions::new();
        options.set_color_output(gif::ColorOutput::RGBA);
        let mut decoder = options.read_info(&bytes[..]).unwrap();
        for frame in &film().frames {
            let read = decoder.read_next_frame().unwrap().unwrap();
            assert_eq!((read.delay, read.buffer[0].abs_diff(frame[0]) < 8), (4, true));
        }
        assert!(decoder.read_next_frame().unwrap().is_none());
    }

    #[test]
    fn what_is_no_film_is_refused() {
        let refused = |film: Film, format| film.encode(format).unwrap_err().to_string();
        assert!(refused(Film { frames: Vec::new(), ..film() }, FilmFormat::Gif).contains("empty"));
        assert!(refused(Film { width: 6, ..film() }, FilmFormat::Mp4).contains("expected 54"));
        let error = FilmFormat::from_path(Path::new("a.avi")).unwrap_err().to_string();
        assert!(error.contains(".gif, .webp, .mp4"), "{error}");
        assert_eq!(FilmFormat::from_path(Path::new("a.MP4")).unwrap(), FilmFormat::Mp4);
    }
}
