//! Tables of known lobes, and what a fit says of rows that it did not see.

use super::*;
use glam::Vec3;
use lobelia_reflectance::table::TableRow;
use lobelia_reflectance::{Brdf, Lobe};

fn options() -> TableOptions {
    TableOptions {
        method: Method::Lm,
        residual: Residual::Log,
        hold_out_theta_deg: vec![30.0],
        random_starts: 4,
        seed: 1,
        bound: AlbedoBound::Bounded,
    }
}

const ZERO: Size = Size { lobes: 0, sharpening: false, microfacet: false };
const ONE: Size = Size { lobes: 1, sharpening: false, microfacet: false };
const TWO: Size = Size { lobes: 2, sharpening: false, microfacet: false };

/// A table of a known material with one lobe at incidences 10° … 70°.
fn table() -> MeasuredTable {
    let lobe = Lobe::new(Rgb::splat(0.8), Vec3::new(-0.95, -0.95, 0.9), 30.0);
    let truth = LobeBrdf { rho_d: Rgb::splat(0.05), beta: 0.0, lobes: vec![lobe], ..LobeBrdf::default() };
    let mut rows = Vec::new();
    for (i, o, p) in
        (1..8).flat_map(|i| (0..8).flat_map(move |o| (0..9).map(move |p| (f64::from(i), f64::from(o), p))))
    {
        let (theta_i, theta_o) = (i * 10f64.to_radians(), o * 10f64.to_radians());
        let phi_o = f64::from(p) / 8.0 * std::f64::consts::PI;
        let mut row = TableRow { theta_i, phi_i: 0.0, theta_o, phi_o, values: vec![] };
        let f = f64::from(truth.eval(row.wi().as_vec3(), row.wo().as_vec3()).x);
        row.values = vec![f, 2.0 * f];
        rows.push(row);
    }
    MeasuredTable { wavelengths_nm: vec![400.0, 600.0], rows }
}

#[test]
fn a_table_of_one_lobe_is_recovered_and_predicts_the_held_out_incidence() {
    let fits = fit(&table(), &[400.0, 500.0, 600.0], &[ZERO, ONE], Take::Size(ONE), &options()).unwrap();
    assert_eq!(fits.len(), 6);
    let one = &fits[3];
    assert_eq!((one.wavelength_nm, one.size, one.chosen), (500.0, ONE, true));
    let held_out = one.held_out.unwrap();
    assert_eq!(held_out.rows, 72);
    assert!(held_out.log_rms < 1e-3 && held_out.relative_l2 < 1e-3, "{one:?}");
    assert!((one.model.lobes[0].n - 30.0).abs() < 0.1);
    assert!(fits[2].held_out.unwrap().relative_l2 > 0.1);
    let brdf = brdf([&fits[5], &fits[3], &fits[1]]);
    assert!((brdf.rho_d - Rgb::new(0.1, 0.075, 0.05)).abs().max_element() < 1e-3, "{brdf:?}");
    let figures = figures(&fits, &options());
    assert_eq!(figures.iter().filter(|figure| figure.name == "held_out_log_rms").count(), 6);
    let json = serde_json::to_value(&figures[0]).unwrap();
    assert_eq!(json["wavelength_nm"], 400.0);
}

#[test]
fn the_data_choose_a_lobe_or_a_coat_over_it() {
    let sizes = [false, true]
        .map(|microfacet| [0, 1, 2].map(|lobes| Size { lobes, sharpening: false, microfacet }))
        .concat();
    let chosen = |table: &MeasuredTable| {
        let fits = fit(table, &[400.0], &sizes, Take::Choose, &options()).unwrap();
        fits.into_iter().find(|fit| fit.chosen).unwrap()
    };
    let mut table = table();
    assert_eq!(chosen(&table).size, ONE);
    let coat = Microfacet { f0: Rgb::splat(0.04), f90: Rgb::ONE, alpha: 0.15 };
    for row in &mut table.rows {
        row.values[0] += f64::from(coat.eval(row.wi().as_vec3(), row.wo().as_vec3()).x);
    }
    let coated = chosen(&table);
    assert_eq!(coated.size, Size { lobes: 1, sharpening: false, microfacet: true }, "{coated:?}");
    let found = coated.model.coat.unwrap();
    assert!((found.alpha - 0.15).abs() < 1e-3 && (found.f0 - 0.04).abs() < 1e-3, "{found:?}");
    assert!((found.f90 - 1.0).abs() < 0.02 && coated.held_out.unwrap().log_rms < 1e-2);
}

#[test]
fn one_deterministic_start_reaches_what_many_random_ones_do_on_measured_paint() {
    let folder = std::env::var("LOBELIA_DATA").unwrap_or_else(|_| "../../shared/data".into());
    let path = std::path::Path::new(&folder).join("brdf/cayman.brdf");
    if !path.exists() {
        println!("skipped: {} is not there", path.display());
        return;
    }
    let options = TableOptions {
        residual: Residual::Balanced,
        hold_out_theta_deg: vec![30.0, 60.0],
        random_starts: 16,
        ..options()
    };
    let fits =
        fit(&MeasuredTable::read(&path).unwrap(), &[650.0], &[ONE, TWO], Take::Size(ONE), &options).unwrap();
    for fit in &fits {
        assert!(fit.start_ratio.unwrap() < 1.02, "{fit:?}");
    }
    assert!(fits[1].held_out.unwrap().log_rms < 0.2, "{fits:?}");
}

#[test]
#[ignore = "long: cargo xtask long"]
fn a_measured_retro_reflector_gets_a_retro_lobe_without_being_told() {
    let folder = std::env::var("LOBELIA_DATA").unwrap_or_else(|_| "../../shared/data".into());
    let path = std::path::Path::new(&folder).join("brdf/retro-3M-jaune.dat");
    if !path.exists() {
        println!("skipped: {} is not there", path.display());
        return;
    }
    let sizes = [false, true]
        .map(|microfacet| [1, 2].map(|lobes| Size { lobes, sharpening: false, microfacet }))
        .concat();
    let options = TableOptions {
        residual: Residual::Balanced,
        hold_out_theta_deg: vec![],
        random_starts: 0,
        ..options()
    };
    let table = MeasuredTable::read(&path).unwrap();
    let fits = fit(&table, &[550.0], &sizes, Take::Choose, &options).unwrap();
    let chosen = fits.iter().find(|fit| fit.chosen).unwrap();
    let mut lobes = chosen.model.lobes.clone();
    lobes.sort_by(|a, b| b.n.total_cmp(&a.n));
    // Its axis points at the light: Cx = Cy = Cz.
    let sharpest = lobes[0];
    assert!(sharpest.n > 100.0 && (sharpest.c.x / sharpest.c.z - 1.0).abs() < 0.02, "{chosen:?}");
}

#[test]
fn a_table_that_makes_energy_is_held_and_says_what_that_costs() {
    let lobe = Lobe::new(Rgb::splat(3.0), Vec3::new(-1.1, -1.1, 0.9), 8.0);
    let metal = LobeBrdf { lobes: vec![lobe], ..LobeBrdf::diffuse(Rgb::splat(0.2)) };
    let mut table = table();
    for row in &mut table.rows {
        let f = f64::from(metal.eval(row.wi().as_vec3(), row.wo().as_vec3()).x);
        row.values = vec![f, f];
    }
    let options = TableOptions { bound: AlbedoBound::Conserved, ..options() };
    let held = fit(&table, &[400.0], &[ONE], Take::Size(ONE), &options).unwrap().remove(0);
    let largest = lobelia_reflectance::albedo::largest(&coloured(&held.model, Rgb::ONE)).x;
    assert!(largest <= 1.0 + conserve::TOLERANCE, "{largest}");
    let free = held.free.unwrap();
    assert!(free.log_rms < 1e-3 && held.training.log_rms > 10.0 * free.log_rms, "{held:?}");
    assert!(figures(&[held], &options).iter().any(|figure| figure.name == "energy_free_training_log_rms"));
}

#[test]
fn lobes_that_sharpen_are_found_and_chosen() {
    let lobe =
        Lobe { n_grazing: Some(60.0), ..Lobe::new(Rgb::splat(0.8), Vec3::new(-0.95, -0.95, 1.0), 15.0) };
    let truth = LobeBrdf { lobes: vec![lobe], ..LobeBrdf::diffuse(Rgb::splat(0.1)) };
    let mut table = table();
    for row in &mut table.rows {
        let f = f64::from(truth.eval(row.wi().as_vec3(), row.wo().as_vec3()).x);
        row.values = vec![f, f];
    }
    let sizes = [ONE, Size { sharpening: true, ..ONE }];
    let fits = fit(&table, &[400.0], &sizes, Take::Choose, &options()).unwrap();
    assert!(fits[1].chosen && fits[1].training.log_rms < 1e-3, "{fits:?}");
    let found = fits[1].model.lobes[0];
    assert!((found.n - 15.0).abs() < 0.1 && (found.n_grazing.unwrap() - 60.0).abs() < 0.5, "{found:?}");
}

#[test]
fn held_out_angles_that_leave_nothing_are_refused() {
    let refused = |angles: Vec<f64>, wavelength: f64| {
        let options = TableOptions { hold_out_theta_deg: angles, ..options() };
        fit(&table(), &[wavelength], &[ONE], Take::Size(ONE), &options).unwrap_err().to_string()
    };
    assert!(refused(vec![35.0], 400.0).contains("held-out 35°"));
    assert!(refused((1..8).map(|i| f64::from(i) * 10.0).collect(), 400.0).contains("nothing is left"));
    assert!(refused(vec![], 399.0).contains("399 nm"));
}
