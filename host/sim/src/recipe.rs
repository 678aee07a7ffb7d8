//! Material recipes: what lies on a simulated rig's carrier, as a TOML file names it.

use std::path::Path;
use std::sync::Arc;

use glam::{Vec2, Vec3};
use lobelia_hil_sim::optics::{Material, Pattern, SampleLayout};
use serde::{Deserialize, Serialize};

use lobelia_base::error::{Error, Result};
use lobelia_base::toml_file;
use lobelia_measure::rig::config::Carrier;
use lobelia_reflectance::table::{InterpolatedBrdf, MeasuredTable};
use lobelia_reflectance::{Lobe, LobeBrdf, Microfacet, Rgb, materials};

/// A sample: materials and their pattern.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Recipe {
    /// How the materials are laid out.
    pub pattern: PatternRecipe,
    /// The materials.
    #[serde(rename = "material")]
    pub materials: Vec<MaterialRecipe>,
}

/// A pattern; lengths in mm.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case", deny_unknown_fields)]
pub enum PatternRecipe {
    /// Vertical stripes.
    Stripes {
        /// Width of a stripe.
        width_mm: f64,
    },
    /// A board of squares.
    Checks {
        /// Edge of a square.
        size_mm: f64,
    },
    /// A plain weave of two thread directions.
    Weave {
        /// From thread to thread.
        pitch_mm: f64,
    },
    /// An image whose brightness picks the material.
    Image {
        /// The image, relative to the recipe.
        path: String,
    },
}

/// A material: exactly one of `published`, `table` and lobes.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MaterialRecipe {
    /// Name of a published lobe material.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub published: Option<String>,
    /// A measured `.brdf` table, relative to the recipe.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub table: Option<String>,
    /// Wavelengths taken for R, G and B of a table.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub wavelengths_nm: Option<[f64; 3]>,
    /// Diffuse reflectance, sr⁻¹.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rho_d: Option<[f32; 3]>,
    /// Direction of anisotropy.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub beta_deg: f32,
    /// x and y of the unit normal about which the lobes stand, where that is not the sample's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub normal: Option<[f32; 2]>,
    /// The lobes.
    #[serde(default, rename = "lobe", skip_serializing_if = "Vec::is_empty")]
    pub lobes: Vec<LobeRecipe>,
    /// A GGX microfacet term.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ggx: Option<Microfacet>,
}

fn is_zero(value: &f32) -> bool {
    *value == 0.0
}

/// One lobe.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LobeRecipe {
    /// ρ_s, sr⁻¹.
    pub rho_s: [f32; 3],
    /// Diagonal of C.
    pub c: [f32; 3],
    /// Exponent.
    pub n: f32,
    /// Exponent toward grazing, of a lobe that sharpens (6.19).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub n_grazing: Option<f32>,
}

impl Recipe {
    /// Reads a recipe and lays its sample out on the carrier.
    ///
    /// # Errors
    /// Input errors naming file, key and material.
    pub fn read(path: &Path, carrier: &Carrier) -> Result<SampleLayout> {
        let recipe: Self = toml_file::read_as(path, toml_file::Kind::Material)?;
        let folder = path.parent().unwrap_or(Path::new("."));
        recipe.layout(folder, carrier).map_err(|error| error.at(path.display()))
    }

    /// Reads a recipe and makes the names of its files absolute, so that it can be kept elsewhere.
    ///
    /// # Errors
    /// Input errors naming file and key.
    pub fn load(path: &Path) -> Result<Self> {
        let mut recipe: Self = toml_file::read_as(path, toml_file::Kind::Material)?;
        let path = std::path::absolute(path).map_err(|error| Error::reading(path, error))?;
        let folder = path.parent().unwrap_or(Path::new("."));
        let name = |file: &str| folder.join(file).to_string_lossy().into_owned();
        if let PatternRecipe::Image { path: image } = &mut recipe.pattern {
            *image = name(image);
        }
        for table in recipe.materials.iter_mut().filter_map(|material| material.table.as_mut()) {
            *table = name(table);
        }
        Ok(recipe)
    }

    /// Lays the sample out; files are relative to `folder`.
    ///
    /// # Errors
    /// Input errors naming the key or material.
    pub fn layout(&self, folder: &Path, carrier: &Carrier) -> Result<SampleLayout> {
        let materials = self.build_materials(folder)?;
        let pattern = self.pattern.build(folder, materials.len())?;
        Ok(SampleLayout::new(carrier.sample_width_mm, carrier.sample_height_mm, materials, pattern))
    }

    /// The recipe's materials; files are relative to `folder`.
    ///
    /// # Errors
    /// Input errors naming the material.
    pub fn build_materials(&self, folder: &Path) -> Result<Vec<Material>> {
        if self.materials.is_empty() {
            return Err(Error::input("the recipe has no material"));
        }
        let build = |(k, material): (usize, &MaterialRecipe)| {
            material.build(folder).map_err(|error| error.at(format!("material {k}")))
        };
        self.materials.iter().enumerate().map(build).collect()
    }
}

impl PatternRecipe {
    fn build(&self, folder: &Path, materials: usize) -> Result<Pattern> {
        let positive = |key: &str, value: f64| {
            if value > 0.0 && value.is_finite() {
                return Ok(value);
            }
            Err(Error::input(format!("pattern.{key} is {value}, must be above 0")))
        };
        Ok(match self {
            Self::Stripes { width_mm } => Pattern::Stripes { width_mm: positive("width_mm", *width_mm)? },
            Self::Checks { size_mm } => Pattern::Checks { size_mm: positive("size_mm", *size_mm)? },
            Self::Weave { pitch_mm } => Pattern::Weave { pitch_mm: positive("pitch_mm", *pitch_mm)? },
            Self::Image { path } => {
                Pattern::from_image(&folder.join(path), materials).map_err(Error::input)?
            }
        })
    }
}

impl MaterialRecipe {
    fn build(&self, folder: &Path) -> Result<Material> {
        match (&self.published, &self.table, self.rho_d) {
            (Some(name), None, None) => {
                let brdf = materials::published(name).ok_or_else(|| {
                    let known = materials::NAMES.join(", ");
                    Error::input(format!("no published material is called `{name}` (known: {known})"))
                })?;
                Ok(Material::Lobes(brdf))
            }
            (None, Some(table), None) => {
                let path = folder.join(table);
                let table = MeasuredTable::read(&path).map_err(Error::format)?;
                let brdf =
                    InterpolatedBrdf::new(&table, self.wavelengths_nm.unwrap_or([650.0, 550.0, 450.0]))
                        .map_err(|error| Error::format(error).at(path.display()))?;
                Ok(Material::Measured(Arc::new(brdf)))
            }
            (None, None, Some(rho_d)) => Ok(Material::Lobes(self.lobe_brdf(rho_d)?)),
            _ => Err(Error::input(
                "exactly one of `published`, `table` and `rho_d` (with lobes) must be given",
            )),
        }
    }

    fn lobe_brdf(&self, rho_d: [f32; 3]) -> Result<LobeBrdf> {
        let finite = |numbers: &[f32]| numbers.iter().all(|x| x.is_finite());
        let exponents = |lobe: &LobeRecipe| lobe.n > 0.0 && lobe.n_grazing.is_none_or(|n| n > 0.0);
        let valid = |lobe: &LobeRecipe| finite(&lobe.rho_s) && finite(&lobe.c) && exponents(lobe);
        if !finite(&rho_d) || !self.lobes.iter().all(valid) {
            return Err(Error::input("a coefficient is not finite or an exponent not above 0"));
        }
        let lobe = |lobe: &LobeRecipe| Lobe {
            n_grazing: lobe.n_grazing,
            ..Lobe::new(Rgb::from_array(lobe.rho_s), Vec3::from_array(lobe.c), lobe.n)
        };
        let normal = Vec2::from_array(self.normal.unwrap_or_default());
        let shorter = normal.length() < 1.0;
        if !shorter {
            return Err(Error::input("normal is x and y of a unit vector: its length must be below 1"));
        }
        if self.ggx.is_some_and(|ggx| !(ggx.alpha > 0.0 && ggx.f0.is_finite() && ggx.f90.is_finite())) {
            return Err(Error::input("ggx: a coefficient is not finite, or alpha is not above 0"));
        }
        let brdf = LobeBrdf {
            rho_d: Rgb::from_array(rho_d),
            beta: 0.0,
            lobes: self.lobes.iter().map(lobe).collect(),
            microfacets: self.ggx.into_iter().collect(),
            ..LobeBrdf::default()
        };
        Ok(LobeBrdf { normal, ..brdf.rotated(self.beta_deg.to_radians()) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_recipe_names_unknown_keys_and_unknown_materials() {
        let unknown =
            toml_file::parse::<Recipe>("pattern = { kind = \"checks\", size = 4 }", "m.toml").unwrap_err();
        assert!(unknown.to_string().contains("size_mm"), "{unknown}");
        let recipe: Recipe = toml_file::parse(
            "pattern = { kind = \"checks\", size_mm = 4 }\n[[material]]\npublished = \"velvet\"\n",
            "m.toml",
        )
        .unwrap();
        let text = recipe.layout(Path::new("."), &Carrier::default()).err().unwrap().to_string();
        assert!(text.contains("material 0") && text.contains("velvet") && text.contains("felt"), "{text}");
    }

    #[test]
    fn a_material_has_the_normal_the_sharpening_and_the_microfacet_term_that_it_names() {
        let recipe = |normal: &str| -> Recipe {
            let text = format!(
                "[pattern]\nkind = \"checks\"\nsize_mm = 4\n[[material]]\nrho_d = [0.1, 0.2, 0.3]\nbeta_deg \
                 = 20\nnormal = {normal}\nlobe = [{{ rho_s = [1, 1, 1], c = [-1, -0.5, 1], n = 20, n_grazing \
                 = 80 }}]\nggx = {{ f0 = [0.04, 0.04, 0.04], f90 = [1, 1, 1], alpha = 0.2 }}\n"
            );
            toml_file::parse(&text, "m.toml").unwrap()
        };
        let Material::Lobes(brdf) = recipe("[0.1, -0.05]").build_materials(Path::new(".")).unwrap().remove(0)
        else {
            panic!("lobes were named");
        };
        assert_eq!((brdf.normal, brdf.lobes[0].n_grazing), (Vec2::new(0.1, -0.05), Some(80.0)));
        assert_eq!(brdf.microfacets, [Microfacet { f0: Rgb::splat(0.04), f90: Rgb::ONE, alpha: 0.2 }]);
        let wrong = recipe("[0.8, 0.8]").build_materials(Path::new(".")).map(|_| ()).unwrap_err();
        assert!(wrong.to_string().contains("normal") && wrong.exit_code() == 2, "{wrong}");
    }

    #[test]
    fn lobes_and_published_materials_lie_where_the_pattern_says() {
        use lobelia_reflectance::Brdf;
        let text = "[pattern]\nkind = \"stripes\"\nwidth_mm = 32\n[[material]]\npublished = \
             \"felt\"\n[[material]]\nrho_d = [0.1, 0.2, 0.3]\nlobe = [{ rho_s = [1, 1, 1], c = [-1, -1, 1], \
             n = 20 }]\n";
        let recipe: Recipe = toml_file::parse(text, "m.toml").unwrap();
        let layout = recipe.layout(Path::new("."), &Carrier::default()).unwrap();
        let f = layout.at(10.0, 0.0).eval(Vec3::Z, Vec3::Z);
        assert!((f - Rgb::new(1.1, 1.2, 1.3)).abs().max_element() < 1e-6);
    }
}
