import js from "@eslint/js";
import globals from "globals";

export default [
  js.configs.recommended,
  {
    languageOptions: { globals: globals.browser },
    rules: {
      "array-callback-return": "error",
      complexity: ["error", 20], // which counts each &&, || and ?:, too
      curly: ["error", "multi-line"],
      eqeqeq: "error",
      "max-len": ["error", { code: 160 }],
      "max-lines": ["error", 500],
      "max-params": ["error", 8],
      "no-eval": "error",
      "no-implied-eval": "error",
      "no-shadow": "off",
      "no-use-before-define": "off",
      "no-var": "error",
      "prefer-const": ["error", { destructuring: "all" }],
      "require-await": "error",
      semi: "error",
    },
  },
];
