//! Parses numbers in text, in the notations of C, Fortran, Python and Microsoft's C library.

/// Maximum length, in bytes, of a number that is rewritten before parsing. Numbers with a decimal
/// comma or a Fortran exponent are rewritten.
const LONGEST: usize = 64;

/// The decimal separator.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Decimal {
    /// A point, as in 0.5.
    Point,
    /// A comma, as in 0,5.
    Comma,
}

/// A number that can be parsed from a word of text.
pub trait ParseNumber: Sized {
    /// The number that `word` represents. `None` if the word is not a number.
    fn of(word: &[u8]) -> Option<Self>;
}

macro_rules! parsed {
    ($($type:ident),*) => {
        $(impl ParseNumber for $type {
            fn of(word: &[u8]) -> Option<Self> {
                std::str::from_utf8(word).ok()?.parse().ok()
            }
        })*
    };
}

parsed!(i64, u64, usize, f32);

impl ParseNumber for f64 {
    fn of(word: &[u8]) -> Option<Self> {
        // Try the notation of C and Python first. The other notations are rare and do not overlap
        // with it.
        short(word)
            .or_else(|| std::str::from_utf8(word).ok()?.parse().ok())
            .or_else(|| not_finite(word))
            .or_else(|| fortran(word))
    }
}

/// Parses a decimal number with few digits and a small exponent.
///
/// f64 represents the digits and the power of ten exactly, so that their product or quotient is the
/// nearest f64 (Clinger, "How to Read Floating Point Numbers Accurately", 1990).
fn short(word: &[u8]) -> Option<f64> {
    /// Maximum number of digits. The integer that these digits form is less than 2^53.
    const MAX_DIGITS: usize = 15;
    /// Maximum number of characters besides the digits: a sign, a point, and an exponent (`e`, a
    /// sign and two digits).
    const MAX_OTHER_CHARACTERS: usize = 6;
    /// Powers of ten that f64 represents exactly. 10^22 is the greatest.
    const POWERS: [f64; 23] = [
        1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15, 1e16,
        1e17, 1e18, 1e19, 1e20, 1e21, 1e22,
    ];
    if word.len() > MAX_DIGITS + MAX_OTHER_CHARACTERS {
        return None;
    }
    let (negative, rest) = match word {
        [b'-', rest @ ..] => (true, rest),
        rest => (false, rest),
    };
    let (mut whole, mut digits, mut fraction, mut exponent) = (0_u64, 0, None, 0);
    for (at, &byte) in rest.iter().enumerate() {
        match byte {
            b'0'..=b'9' if digits < MAX_DIGITS => {
                whole = 10 * whole + u64::from(byte - b'0');
                digits += 1;
            }
            b'.' if fraction.is_none() => fraction = Some(digits),
            b'e' | b'E' => {
                exponent = short_exponent(&rest[at + 1..])?;
                break;
            }
            _ => return None,
        }
    }
    if digits == 0 {
        return None;
    }
    let digits_after_point = fraction.map_or(0, |before| digits - before);
    let power = exponent - digits_after_point as i32;
    let factor = *POWERS.get(power.unsigned_abs() as usize)?;
    let number = if power < 0 { whole as f64 / factor } else { whole as f64 * factor };
    Some(if negative { -number } else { number })
}

/// Parses an exponent of one or two digits with an optional sign.
fn short_exponent(text: &[u8]) -> Option<i32> {
    let (sign, digits) = match text {
        [b'-', digits @ ..] => (-1, digits),
        [b'+', digits @ ..] => (1, digits),
        digits => (1, digits),
    };
    let digit = |byte: u8| byte.is_ascii_digit().then(|| i32::from(byte - b'0'));
    match *digits {
        [ones] => Some(sign * digit(ones)?),
        [tens, ones] => Some(sign * (10 * digit(tens)? + digit(ones)?)),
        _ => None,
    }
}

/// Parses the number in `word` with the decimal separator `decimal`.
pub fn with_decimal(word: &[u8], decimal: Decimal) -> Option<f64> {
    if decimal == Decimal::Point {
        return f64::of(word);
    }
    if !word.contains(&b',') {
        // If commas are decimal separators, a point separates thousands. Numbers with thousands
        // separators are not supported.
        return f64::of(word).filter(|number| !number.is_finite() || !word.contains(&b'.'));
    }
    if word.contains(&b'.') {
        return None;
    }
    let mut buffer = [0; LONGEST];
    let rewritten = buffer.get_mut(..word.len())?;
    rewritten.copy_from_slice(word);
    // A second comma becomes a second point, so that the number is rejected.
    rewritten.iter_mut().filter(|byte| **byte == b',').for_each(|byte| *byte = b'.');
    f64::of(rewritten)
}

/// Whether a word consists of asterisks, which Fortran writes if a number does not fit in its
/// field.
pub fn is_overflow(word: &[u8]) -> bool {
    !word.is_empty() && word.iter().all(|&byte| byte == b'*')
}

/// Parses NaN and infinity in notations that [`str::parse`] does not accept.
fn not_finite(word: &[u8]) -> Option<f64> {
    let (negative, rest) = match word {
        [b'-', rest @ ..] => (true, rest),
        [b'+', rest @ ..] => (false, rest),
        rest => (false, rest),
    };
    let mut buffer = [0; LONGEST];
    let upper = buffer.get_mut(..rest.len())?;
    upper.copy_from_slice(rest);
    upper.make_ascii_uppercase();
    let infinity = if negative { f64::NEG_INFINITY } else { f64::INFINITY };
    if let Some(payload) = upper.strip_prefix(b"NAN") {
        // C writes `nan(ind)` and `nan(0x7)`. IBM's compilers write NANQ and NANS.
        let known = matches!(payload, b"Q" | b"S")
            || matches!(payload, [b'(', inside @ .., b')'] if inside.iter().all(is_of_payload));
        return known.then_some(f64::NAN);
    }
    // Before 2015, Microsoft's C library wrote NaN and infinity as the digit 1 with a name as its
    // fraction. The name was rounded to the requested digits and padded with zeros: 1.#QNAN,
    // 1.#INF00e+000, 1.#IO.
    let name = upper.strip_prefix(b"1.")?;
    let name = match name.iter().position(|&byte| byte == b'E') {
        Some(at) if is_exponent(&name[at + 1..]) => &name[..at],
        _ => name,
    };
    let end = name.iter().rposition(|&byte| byte != b'0').map_or(0, |last| last + 1);
    match &name[..end] {
        b"#INF" => Some(infinity),
        b"#QNAN" | b"#SNAN" | b"#IND" | b"#NAN" => Some(f64::NAN),
        // Rounded names of NaN. Some of them, such as `#IO` and `#J`, may also stand for infinity,
        // but are read as NaN.
        b"#QNB" | b"#SNB" | b"#QO" | b"#SO" | b"#IO" | b"#R" | b"#T" | b"#J" | b"$" => {
            Some(f64::NAN)
        }
        _ => None,
    }
}

fn is_of_payload(byte: &u8) -> bool {
    byte.is_ascii_alphanumeric() || *byte == b'_'
}

fn is_exponent(digits: &[u8]) -> bool {
    let digits = digits.strip_prefix(b"+").or(digits.strip_prefix(b"-")).unwrap_or(digits);
    !digits.is_empty() && digits.iter().all(u8::is_ascii_digit)
}

/// Parses a number with a Fortran exponent. The exponent begins with D or Q instead of E, or
/// consists of a sign and three digits without a letter.
fn fortran(word: &[u8]) -> Option<f64> {
    let sign = usize::from(matches!(word.first(), Some(b'+' | b'-')));
    let at = sign + word[sign..].iter().position(|b| !b.is_ascii_digit() && *b != b'.')?;
    let (mantissa, exponent) = word.split_at(at);
    let exponent = match exponent {
        [b'D' | b'd' | b'Q' | b'q', exponent @ ..] if is_exponent(exponent) => exponent,
        // Require three digits and a point, because `1.5-10` could be two numbers without a
        // separator.
        [b'+' | b'-', digits @ ..] if digits.len() == 3 && mantissa.contains(&b'.') => exponent,
        _ => return None,
    };
    if !is_exponent(exponent) {
        return None;
    }
    let mut buffer = [0; LONGEST];
    let rewritten = buffer.get_mut(..mantissa.len() + 1 + exponent.len())?;
    rewritten[..at].copy_from_slice(mantissa);
    rewritten[at] = b'E';
    rewritten[at + 1..].copy_from_slice(exponent);
    std::str::from_utf8(rewritten).ok()?.parse().ok()
}

/// Whether a number is a plausible length. Numbers that are read with the wrong type or byte order
/// have arbitrary magnitudes.
pub fn is_length(number: f64) -> bool {
    number == 0.0 || (1e-12..1e12).contains(&number.abs())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nan_and_infinity_are_read_in_every_spelling() {
        for word in [
            "nan",
            "-NaN",
            "NaN",
            "+nan",
            "-nan(ind)",
            "nan(snan)",
            "nan(0x8000)",
            "NaNQ",
            "1.#QNAN",
            "-1.#QNAN",
            "1.#SNAN",
            "-1.#IND",
            "-1.#IND00",
            "1.#QNAN0e+000",
            "1.#IO",
            "1.#QO",
            "-1.#J",
            "1.#R",
            "1.$",
        ] {
            assert!(f64::of(word.as_bytes()).is_some_and(f64::is_nan), "{word}");
        }
        for word in ["inf", "+Inf", "Infinity", "+INFINITY", "1.#INF", "1.#INF00", "1.#INF000e+000"]
        {
            assert_eq!(f64::of(word.as_bytes()), Some(f64::INFINITY), "{word}");
        }
        assert_eq!(f64::of(b"-1.#INF"), Some(f64::NEG_INFINITY));
        for word in ["nano", "nan(", "nan()x", "1.#", "1.#FOO", "2.#INF", "1#INF", "inf0"] {
            assert_eq!(f64::of(word.as_bytes()), None, "{word}");
        }
    }

    #[test]
    fn decimals_are_parsed_like_the_standard_library_parses_them() {
        for word in [
            "0",
            "-0",
            "-0.0",
            "0.1",
            ".5",
            "5.",
            "123456789012345",
            "0.00000000000001",
            "9007199254740993",
            "0.3",
            "-12345.6789012345",
            "999999999999.999",
            "1.23456789e-01",
            "-1.23456789E+22",
            "123456789012345e7",
            "0.1e-21",
            "0e99",
            "1.5e2",
            "9007199254740993e5",
            "1e-7",
        ] {
            let number: f64 = word.parse().unwrap();
            assert_eq!(
                f64::of(word.as_bytes()).map(f64::to_bits),
                Some(number.to_bits()),
                "{word}"
            );
        }
        for word in ["", "-", ".", "-.", "1.2.3", "1 2", "e5", "1e", "1e+", "1e5.", "1ee5", "-e1"] {
            assert_eq!(f64::of(word.as_bytes()), None, "{word}");
        }
    }

    #[test]
    fn fortran_exponents_are_read_but_joined_numbers_are_not() {
        let same = [
            ("1.5D-01", 0.15),
            ("1.5d+3", 1500.0),
            ("-.5D0", -0.5),
            ("2D2", 200.0),
            ("0.14-270", 0.14e-270),
            ("-0.14+100", -0.14e100),
            ("1.5Q2", 150.0),
        ];
        for (word, number) in same {
            assert_eq!(f64::of(word.as_bytes()), Some(number), "{word}");
        }
        for word in
            ["1.5-10", "0.5-0.25", "2024-001", "1.5D", "1.5D+", "D5", "1.5DD5", "1.5-1e0", "*****"]
        {
            assert_eq!(f64::of(word.as_bytes()), None, "{word}");
        }
    }

    #[test]
    fn a_decimal_comma_excludes_decimal_points_and_thousands_separators() {
        let comma = |word: &str| with_decimal(word.as_bytes(), Decimal::Comma);
        assert_eq!(comma("-0,25e1"), Some(-2.5));
        assert_eq!(comma("3"), Some(3.0));
        assert!(comma("1.#QNAN").is_some_and(f64::is_nan) && comma("1,#IND").is_some());
        for word in ["0.5", "1.000,5", "1,000,000", ","] {
            assert_eq!(comma(word), None, "{word}");
        }
        assert_eq!(with_decimal(b"0,5", Decimal::Point), None);
    }
}
