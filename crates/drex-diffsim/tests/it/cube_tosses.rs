//! Tosses of a real cube: friction and rebound fitted on the odd-numbered ones, judged on the even-numbered ones.

use crate::recorded::cube::{Toss, median, tosses};
use crate::recorded::{fit, shared};

#[test]
fn a_fit_on_odd_tosses_predicts_even_ones() {
    let Some(shared) = shared() else { return };
    let seen: Vec<Toss> = tosses(&shared, 0.0).into_iter().filter(|t| t.number % 2 == 1).collect();
    let table_m = fit::table_height(&seen);
    let all = tosses(&shared, table_m);
    let (odd, even): (Vec<&Toss>, Vec<&Toss>) = all.iter().partition(|t| t.number % 2 == 1);
    let (parameters, mean_mm) = fit::fit(&odd);
    println!("table at {:+.2} mm; {parameters:?}; odd: mean {mean_mm:.1} mm", table_m * 1e3);
    let starts = fit::starts(&even);
    let errors = fit::predict(&even, &starts, &parameters, true);
    let (mm, face) = (median(errors.mm.clone()), errors.face_percent());
    let (slides_on, stops) = fit::ballistic(&even, &starts);
    println!("even: median {mm:.1} mm, {:.1} deg; face {face:.1} %", median(errors.deg.clone()));
    println!(
        "without contact: {slides_on:.1} mm sliding on, {stops:.1} mm stopping; face kept {:.1} %",
        fit::kept_face(&even)
    );
    assert!(mm <= 60.0, "{mm} mm");
    assert!(face >= 65.0, "{face} %");
}
