//! Operations on 32-bit scalars, computed for all lanes at once.

use half::f16;
use spirv::{GLOp, Op};

macro_rules! operations {
    ($(#[$doc:meta])* $name:ident: $($variant:ident = [$($op:ident)?] [$($gl:ident)?],)*) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub(crate) enum $name { $($variant,)* }
        impl $name {
            /// Returns the operation of an opcode that works on each component.
            pub fn of(op: Op) -> Option<$name> {
                match op { $($(Op::$op => Some($name::$variant),)?)* _ => None }
            }
            /// Returns the operation of a `GLSL.std.450` instruction by component.
            pub fn glsl(op: GLOp) -> Option<$name> {
                match op { $($(GLOp::$gl => Some($name::$variant),)?)* _ => None }
            }
        }
    };
}

operations! {
    /// Operation with one operand.
    Un:
    Copy = [] [], Bitcast = [Bitcast] [], Not = [Not] [], LogicalNot = [LogicalNot] [],
    SNegate = [SNegate] [], FNegate = [FNegate] [],
    ConvertFToU = [ConvertFToU] [], ConvertFToS = [ConvertFToS] [], ConvertSToF = [ConvertSToF] [],
    ConvertUToF = [ConvertUToF] [], BitCount = [BitCount] [], BitReverse = [BitReverse] [],
    IsNan = [IsNan] [], IsInf = [IsInf] [],
    FAbs = [] [FAbs], SAbs = [] [SAbs], FSign = [] [FSign], SSign = [] [SSign], Floor = [] [Floor],
    Ceil = [] [Ceil], Trunc = [] [Trunc], Fract = [] [Fract], RoundEven = [] [RoundEven], Round = [] [Round],
    Sqrt = [] [Sqrt], InverseSqrt = [] [InverseSqrt], Exp = [] [Exp], Exp2 = [] [Exp2], Log = [] [Log],
    Log2 = [] [Log2], Sin = [] [Sin], Cos = [] [Cos], Tan = [] [Tan], Asin = [] [Asin], Acos = [] [Acos],
    Atan = [] [Atan], Sinh = [] [Sinh], Cosh = [] [Cosh], Tanh = [] [Tanh],
    FindILsb = [] [FindILsb], FindUMsb = [] [FindUMsb],
    HalfLow = [] [], HalfHigh = [] [], RoundHalf = [] [], FrexpMantissa = [] [], FrexpExponent = [] [],
}

operations! {
    /// Operation with two operands.
    Bin:
    IAdd = [IAdd] [], ISub = [ISub] [], IMul = [IMul] [], UDiv = [UDiv] [], SDiv = [SDiv] [], UMod = [UMod] [],
    SRem = [SRem] [], SMod = [SMod] [],
    ShiftLeft = [ShiftLeftLogical] [], ShiftRight = [ShiftRightLogical] [], ShiftRightSigned = [ShiftRightArithmetic] [],
    And = [BitwiseAnd] [], Or = [BitwiseOr] [], Xor = [BitwiseXor] [],
    LogicalAnd = [LogicalAnd] [], LogicalOr = [LogicalOr] [], LogicalEqual = [LogicalEqual] [],
    LogicalNotEqual = [LogicalNotEqual] [],
    IEqual = [IEqual] [], INotEqual = [INotEqual] [], ULess = [ULessThan] [], ULessEqual = [ULessThanEqual] [],
    UGreater = [UGreaterThan] [], UGreaterEqual = [UGreaterThanEqual] [], SLess = [SLessThan] [],
    SLessEqual = [SLessThanEqual] [], SGreater = [SGreaterThan] [], SGreaterEqual = [SGreaterThanEqual] [],
    FEqual = [FOrdEqual] [], FNotEqual = [FUnordNotEqual] [], FOrdNotEqual = [FOrdNotEqual] [],
    FLess = [FOrdLessThan] [], FLessEqual = [FOrdLessThanEqual] [], FGreater = [FOrdGreaterThan] [],
    FGreaterEqual = [FOrdGreaterThanEqual] [],
    FAdd = [FAdd] [], FSub = [FSub] [], FMul = [FMul] [], FDiv = [FDiv] [], FRem = [FRem] [], FMod = [FMod] [],
    FMin = [] [FMin], FMax = [] [FMax], UMin = [] [UMin], UMax = [] [UMax], SMin = [] [SMin], SMax = [] [SMax],
    Pow = [] [Pow], Atan2 = [] [Atan2], Step = [] [Step], Ldexp = [] [Ldexp],
    PackHalf = [] [], Unorm8 = [] [], Unorm16 = [] [],
}

operations! {
    /// Operation with three operands.
    Tri:
    Select = [] [], Fma = [] [Fma], FClamp = [] [FClamp], UClamp = [] [UClamp], SClamp = [] [SClamp],
    FMix = [] [FMix], SmoothStep = [] [SmoothStep],
    BitFieldU = [BitFieldUExtract] [], BitFieldS = [BitFieldSExtract] [],
}

/// One 32-bit value for each lane.
pub(crate) type Lanes<const N: usize> = [u32; N];

fn f(x: u32) -> f32 {
    f32::from_bits(x)
}

fn each<const N: usize>(a: &Lanes<N>, op: impl Fn(u32) -> u32) -> Lanes<N> {
    std::array::from_fn(|l| op(a[l]))
}

fn float<const N: usize>(a: &Lanes<N>, op: impl Fn(f32) -> f32) -> Lanes<N> {
    std::array::from_fn(|l| op(f(a[l])).to_bits())
}

fn pair<const N: usize>(a: &Lanes<N>, b: &Lanes<N>, op: impl Fn(u32, u32) -> u32) -> Lanes<N> {
    std::array::from_fn(|l| op(a[l], b[l]))
}

fn signed<const N: usize>(a: &Lanes<N>, b: &Lanes<N>, op: impl Fn(i32, i32) -> i32) -> Lanes<N> {
    std::array::from_fn(|l| op(a[l] as i32, b[l] as i32) as u32)
}

fn floats<const N: usize>(a: &Lanes<N>, b: &Lanes<N>, op: impl Fn(f32, f32) -> f32) -> Lanes<N> {
    std::array::from_fn(|l| op(f(a[l]), f(b[l])).to_bits())
}

fn truth<const N: usize>(a: &Lanes<N>, b: &Lanes<N>, op: impl Fn(f32, f32) -> bool) -> Lanes<N> {
    std::array::from_fn(|l| u32::from(op(f(a[l]), f(b[l]))))
}

/// Splits a float into a mantissa from 0.5 to 1 and an exponent.
fn frexp(x: f32) -> (f32, i32) {
    if x == 0.0 || !x.is_finite() {
        return (x, 0);
    }
    let (scaled, shift) = if x.abs() < f32::MIN_POSITIVE { (x * 33_554_432.0, -25) } else { (x, 0) };
    let bits = scaled.to_bits();
    let exponent = ((bits >> 23) & 0xff) as i32 - 126;
    (f((bits & 0x807f_ffff) | (126 << 23)), exponent + shift)
}

/// Computes an operation of one operand.
pub(crate) fn un<const N: usize>(op: Un, a: &Lanes<N>) -> Lanes<N> {
    match op {
        Un::Copy | Un::Bitcast => *a,
        Un::Not => each(a, |x| !x),
        Un::LogicalNot => each(a, |x| x ^ 1),
        Un::SNegate => each(a, u32::wrapping_neg),
        Un::FNegate => each(a, |x| x ^ 0x8000_0000),
        Un::ConvertFToU => each(a, |x| f(x) as u32),
        Un::ConvertFToS => each(a, |x| f(x) as i32 as u32),
        Un::ConvertSToF => each(a, |x| (x as i32 as f32).to_bits()),
        Un::ConvertUToF => each(a, |x| (x as f32).to_bits()),
        Un::BitCount => each(a, u32::count_ones),
        Un::BitReverse => each(a, u32::reverse_bits),
        Un::IsNan => each(a, |x| u32::from(f(x).is_nan())),
        Un::IsInf => each(a, |x| u32::from(f(x).is_infinite())),
        Un::FAbs => each(a, |x| x & 0x7fff_ffff),
        Un::SAbs => each(a, |x| (x as i32).wrapping_abs() as u32),
        Un::FSign => float(a, |x| {
            if x > 0.0 {
                1.0
            } else if x < 0.0 {
                -1.0
            } else {
                0.0
            }
        }),
        Un::SSign => each(a, |x| (x as i32).signum() as u32),
        Un::Floor => float(a, f32::floor),
        Un::Ceil => float(a, f32::ceil),
        Un::Trunc => float(a, f32::trunc),
        Un::Fract => float(a, |x| x - x.floor()),
        Un::RoundEven | Un::Round => float(a, f32::round_ties_even),
        Un::Sqrt => float(a, f32::sqrt),
        Un::InverseSqrt => float(a, |x| 1.0 / x.sqrt()),
        Un::Exp => float(a, f32::exp),
        Un::Exp2 => float(a, f32::exp2),
        Un::Log => float(a, f32::ln),
        Un::Log2 => float(a, f32::log2),
        Un::Sin => float(a, f32::sin),
        Un::Cos => float(a, f32::cos),
        Un::Tan => float(a, f32::tan),
        Un::Asin => float(a, f32::asin),
        Un::Acos => float(a, f32::acos),
        Un::Atan => float(a, f32::atan),
        Un::Sinh => float(a, f32::sinh),
        Un::Cosh => float(a, f32::cosh),
        Un::Tanh => float(a, f32::tanh),
        Un::FindILsb => each(a, |x| if x == 0 { u32::MAX } else { x.trailing_zeros() }),
        Un::FindUMsb => each(a, |x| if x == 0 { u32::MAX } else { 31 - x.leading_zeros() }),
        Un::RoundHalf => float(a, |x| f16::from_f32(x).to_f32()),
        Un::HalfLow => each(a, |x| f16::from_bits(x as u16).to_f32().to_bits()),
        Un::HalfHigh => each(a, |x| f16::from_bits((x >> 16) as u16).to_f32().to_bits()),
        Un::FrexpMantissa => float(a, |x| frexp(x).0),
        Un::FrexpExponent => each(a, |x| frexp(f(x)).1 as u32),
    }
}

impl Bin {
    /// Returns whether the operation is undefined for some operands.
    pub fn is_partial(self) -> bool {
        matches!(self, Bin::UDiv | Bin::UMod | Bin::SDiv | Bin::SRem | Bin::SMod)
            || matches!(self, Bin::ShiftLeft | Bin::ShiftRight | Bin::ShiftRightSigned)
    }
}

/// Returns whether an operation is undefined for two operands.
pub(crate) fn undefined(op: Bin, a: u32, b: u32) -> bool {
    match op {
        Bin::UDiv | Bin::UMod => b == 0,
        Bin::SDiv | Bin::SRem | Bin::SMod => b == 0 || (a == 0x8000_0000 && b == u32::MAX),
        Bin::ShiftLeft | Bin::ShiftRight | Bin::ShiftRightSigned => b >= 32,
        _ => false,
    }
}

/// Computes an operation of two operands.
pub(crate) fn bin<const N: usize>(op: Bin, a: &Lanes<N>, b: &Lanes<N>) -> Lanes<N> {
    match op {
        Bin::IAdd => pair(a, b, u32::wrapping_add),
        Bin::ISub => pair(a, b, u32::wrapping_sub),
        Bin::IMul => pair(a, b, u32::wrapping_mul),
        Bin::UDiv => pair(a, b, |x, y| x.checked_div(y).unwrap_or(u32::MAX)),
        Bin::UMod => pair(a, b, |x, y| x.checked_rem(y).unwrap_or(u32::MAX)),
        Bin::SDiv => signed(a, b, |x, y| x.checked_div(y).unwrap_or(-1)),
        Bin::SRem => signed(a, b, |x, y| x.checked_rem(y).unwrap_or(-1)),
        Bin::SMod => signed(a, b, |x, y| {
            let r = x.checked_rem(y).unwrap_or(-1);
            if r != 0 && (r < 0) != (y < 0) { r.wrapping_add(y) } else { r }
        }),
        Bin::ShiftLeft => pair(a, b, u32::wrapping_shl),
        Bin::ShiftRight => pair(a, b, u32::wrapping_shr),
        Bin::ShiftRightSigned => pair(a, b, |x, y| (x as i32).wrapping_shr(y) as u32),
        Bin::And | Bin::LogicalAnd => pair(a, b, |x, y| x & y),
        Bin::Or | Bin::LogicalOr => pair(a, b, |x, y| x | y),
        Bin::Xor => pair(a, b, |x, y| x ^ y),
        Bin::IEqual | Bin::LogicalEqual => pair(a, b, |x, y| u32::from(x == y)),
        Bin::INotEqual | Bin::LogicalNotEqual => pair(a, b, |x, y| u32::from(x != y)),
        Bin::ULess => pair(a, b, |x, y| u32::from(x < y)),
        Bin::ULessEqual => pair(a, b, |x, y| u32::from(x <= y)),
        Bin::UGreater => pair(a, b, |x, y| u32::from(x > y)),
        Bin::UGreaterEqual => pair(a, b, |x, y| u32::from(x >= y)),
        Bin::SLess => signed(a, b, |x, y| i32::from(x < y)),
        Bin::SLessEqual => signed(a, b, |x, y| i32::from(x <= y)),
        Bin::SGreater => signed(a, b, |x, y| i32::from(x > y)),
        Bin::SGreaterEqual => signed(a, b, |x, y| i32::from(x >= y)),
        Bin::FEqual => truth(a, b, |x, y| x == y),
        Bin::FNotEqual => truth(a, b, |x, y| x != y),
        Bin::FOrdNotEqual => truth(a, b, |x, y| x != y && !x.is_nan() && !y.is_nan()),
        Bin::FLess => truth(a, b, |x, y| x < y),
        Bin::FLessEqual => truth(a, b, |x, y| x <= y),
        Bin::FGreater => truth(a, b, |x, y| x > y),
        Bin::FGreaterEqual => truth(a, b, |x, y| x >= y),
        Bin::FAdd => floats(a, b, |x, y| x + y),
        Bin::FSub => floats(a, b, |x, y| x - y),
        Bin::FMul => floats(a, b, |x, y| x * y),
        Bin::FDiv => floats(a, b, |x, y| x / y),
        Bin::FRem => floats(a, b, |x, y| x % y),
        Bin::FMod => floats(a, b, |x, y| x - y * (x / y).floor()),
        Bin::FMin => floats(a, b, f32::min),
        Bin::FMax => floats(a, b, f32::max),
        Bin::UMin => pair(a, b, u32::min),
        Bin::UMax => pair(a, b, u32::max),
        Bin::SMin => signed(a, b, i32::min),
        Bin::SMax => signed(a, b, i32::max),
        Bin::Pow => floats(a, b, f32::powf),
        Bin::Atan2 => floats(a, b, f32::atan2),
        Bin::Step => floats(a, b, |edge, x| if x < edge { 0.0 } else { 1.0 }),
        Bin::Ldexp => pair(a, b, |x, e| ((f64::from(f(x)) * f64::from(e as i32).exp2()) as f32).to_bits()),
        Bin::PackHalf => pair(a, b, |x, y| {
            let half = |x: u32| u32::from(f16::from_f32(f(x)).to_bits());
            half(x) | half(y) << 16
        }),
        Bin::Unorm8 => pair(a, b, |x, k| (((x >> (8 * k)) & 0xff) as f32 / 255.0).to_bits()),
        Bin::Unorm16 => pair(a, b, |x, k| (((x >> (16 * k)) & 0xffff) as f32 / 65535.0).to_bits()),
    }
}

/// Computes an operation of three operands.
///
/// A fused multiplication rounds through double precision: the product is exact there, and the sum is off by one last
/// bit of a float in rare cases.
pub(crate) fn tri<const N: usize>(op: Tri, a: &Lanes<N>, b: &Lanes<N>, c: &Lanes<N>) -> Lanes<N> {
    let bits = |op: &dyn Fn(u32, u32, u32) -> u32| std::array::from_fn(|l| op(a[l], b[l], c[l]));
    match op {
        Tri::Select => std::array::from_fn(|l| if a[l] != 0 { b[l] } else { c[l] }),
        Tri::Fma => {
            std::array::from_fn(|l| ((f64::from(f(a[l])) * f64::from(f(b[l])) + f64::from(f(c[l]))) as f32).to_bits())
        }
        Tri::FClamp => std::array::from_fn(|l| f(a[l]).max(f(b[l])).min(f(c[l])).to_bits()),
        Tri::UClamp => bits(&|x, low, high| x.max(low).min(high)),
        Tri::SClamp => bits(&|x, low, high| (x as i32).max(low as i32).min(high as i32) as u32),
        Tri::FMix => std::array::from_fn(|l| (f(a[l]) * (1.0 - f(c[l])) + f(b[l]) * f(c[l])).to_bits()),
        Tri::SmoothStep => bits(&|low, high, x| {
            let t = ((f(x) - f(low)) / (f(high) - f(low))).clamp(0.0, 1.0);
            (t * t * (3.0 - 2.0 * t)).to_bits()
        }),
        Tri::BitFieldU => {
            bits(&|x, offset, count| ((u64::from(x) >> offset.min(32)) & ((1 << count.min(32)) - 1)) as u32)
        }
        Tri::BitFieldS => bits(&|x, offset, count| {
            let count = count.min(32);
            if count == 0 { 0 } else { (((i64::from(x) >> offset.min(32)) << (64 - count)) >> (64 - count)) as u32 }
        }),
    }
}
