"""A report in German: its sentences."""

from __future__ import annotations

from collections.abc import Mapping

SENTENCES: Mapping[str, str] = {
    "{vessel}; model: {name}": "{vessel}; Modell: {name}",
    "the whole drive train": "der ganze Antriebsstrang",
    "drive train without further elements": "Antriebsstrang ohne weitere Elemente",
    "drive train with {elements}": "Antriebsstrang mit {elements}",
    "Skip to the parameters": "Zu den Parametern springen",
    "Contents": "Inhalt",
    "Parameters": "Parameter",
    "The speed loop": "Der Drehzahlregelkreis",
    "Signals and model": "Signale und Modell",
    "Frequency responses": "Frequenzgänge",
    "Samples used and left out": "Benutzte und ausgelassene Messwerte",
    "Log quality": "Güte der Aufzeichnung",
    "Sensors and how the signals were made": "Sensoren und wie die Signale entstanden",
    "Statistics": "Statistik",
    "Verdict in full, fits, residual tests": "Vollständiges Urteil, Anpassung, Tests der Residuen",
    "Settings and versions": "Einstellungen und Versionen",
    "versions of the software that made this page": "Versionen der Programme, die diese Seite erzeugt haben",
    "software": "Programm",
    "version": "Version",
    "Structure, settings and seed": "Struktur, Einstellungen und Startwert des Zufalls",
    "No verdict was given.": "Es gibt kein Urteil.",
    "What it means for the speed loop": "Was das für den Drehzahlregelkreis heißt",
    "{low} to {high}": "{low} bis {high}",
    "none": "keine",
    "no limit": "keine Grenze",
    "estimate at its lower end": "Schätzwert am unteren Ende",
    "estimate at its upper end": "Schätzwert am oberen Ende",
    "inertia of the whole drive train": "Trägheitsmoment des ganzen Antriebsstrangs",
    "inertia behind the torque gauge": "Trägheitsmoment hinter der Messstelle",
    "{inertia}, seen from the propeller shaft": "{inertia}, auf die Propellerwelle bezogen",
    "at most {high}": "höchstens {high}",
    "may be none": "vielleicht keine",
    "well damped": "gut gedämpft",
    "lively": "lebhaft",
    "close to swinging": "nahe am Schwingen",
    "parameters with their 95 % intervals": "Parameter mit ihren 95-%-Bereichen",
    "combinations with their 95 % intervals": "Kombinationen mit ihren 95-%-Bereichen",
    "What the symbols mean": "Was die Zeichen bedeuten",
    "the truth that the log was simulated with": "der Wahrheit, mit der die Aufzeichnung simuliert wurde",
    "the estimate": "des Schätzwerts",
    "Estimates with their 95 % intervals, in per cent of {reference}.": (
        "Schätzwerte mit ihren 95-%-Bereichen, in Prozent {reference}."
    ),
    "Red where the interval does not hold the truth.": "Rot, wo der Bereich die Wahrheit nicht enthält.",
    "symbol": "Zeichen",
    "name": "Name",
    "estimate": "Schätzwert",
    "std": "Std.-Abw.",
    "95 % interval": "95-%-Bereich",
    "unit": "Einheit",
    "truth": "Wahrheit",
    "formula": "Formel",
    "status": "Stand",
    "element": "Element",
    "found": "Befund",
    "change of the deviance": "Änderung der Devianz",
    "change of the deviance [-]": "Änderung der Devianz [-]",
    "limit at 95 %": "Grenze (95 %)",
    "acts": "wirkt",
    "not found to act": "keine Wirkung gefunden",
    "the others explain it": "die übrigen erklären es",
    "forced by the user": "vom Benutzer vorgegeben",
    "above": "über",
    "below": "unter",
    "poles, margins and gains of the loop": "Pole, Reserven und Verstärkungen des Kreises",
    "figure": "Größe",
    "note": "Anmerkung",
    "time [s]": "Zeit [s]",
    "{name}: signals, model, and what the model leaves over, against time": "{name}: Signale, Modell und Rest über der Zeit",
    "every sample is in the page": "jeder Messwert steht in der Seite",
    "smallest and largest of every {width} samples ({time} ms) are in the page": (
        "kleinster und größter von je {width} Messwerten ({time} ms) stehen in der Seite"
    ),
    "Drag across to zoom, double-click to see all. With the keyboard: arrows move, + and − zoom, 0 shows all, n and p go from "
    "fault to fault.": (
        "Ziehen vergrößert, Doppelklick zeigt alles. Mit der Tastatur: Pfeile verschieben, + und − vergrößern, 0 zeigt alles, "
        "n und p gehen von Fehler zu Fehler."
    ),
    "model of {name}": "Modell von {name}",
    "{name} − model [{unit}]": "{name} − Modell [{unit}]",
    "{name} less the model": "{name} ohne das Modell",
    "{name}: signals; masked samples, marked at the bottom, are not fitted.": (
        "{name}: Signale; ausgeblendete Messwerte, unten markiert, gehen nicht in die Anpassung ein."
    ),
    "{name}: measured response to the set point with bars of two standard deviations, and the fitted model's.": (
        "{name}: gemessener Frequenzgang zum Sollwert mit Balken von zwei Standardabweichungen, und der des Modells."
    ),
    "zoom of": "Ausschnitt von",
    "zoom in": "vergrößern",
    "zoom out": "verkleinern",
    "earlier": "früher",
    "later": "später",
    "all": "alles",
    "show all": "alles zeigen",
    "fault": "Fehler",
    "previous fault": "voriger Fehler",
    "next fault": "nächster Fehler",
    "save as CSV": "als CSV sichern",
    "save as PNG": "als PNG sichern",
    "show or hide": "zeigen oder verbergen:",
    "zoomable plot": "Bild mit Ausschnitt",
    "to": "bis",
    "of": "von",
    "at": "bei",
    "time [h:min:s]": "Zeit [h:min:s]",
    "masked": "ausgeblendet",
    "Samples as the logger recorded them; each is counted once. Repaired ones are fitted; cut ones are not, even where "
    "something was put in their place so that the filter passes over them.": (
        "Messwerte, wie sie aufgezeichnet wurden; jeder ist einmal gezählt. Reparierte gehen in die Anpassung ein, "
        "ausgeschnittene nicht, auch wo etwas an ihre Stelle trat, damit das Filter über sie hinwegkommt."
    ),
    "fate of the recorded samples of each channel": "was aus den Messwerten jedes Kanals wurde",
    "channel": "Kanal",
    "log": "Aufzeichnung",
    "recorded": "aufgezeichnet",
    "kept": "behalten",
    "repaired": "repariert",
    "cut": "ausgeschnitten",
    "another sensor used": "anderer Sensor verwendet",
    "outside windows": "außerhalb der Fenster",
    "Samples of the experiments that were cut from the logs, after filtering.": (
        "Messwerte der Versuche, die aus den Aufzeichnungen geschnitten wurden, nach dem Filtern."
    ),
    "samples of each experiment in the fit": "Messwerte jedes Versuchs in der Anpassung",
    "experiment": "Versuch",
    "kind": "Art",
    "length [s]": "Dauer [s]",
    "rate [Hz]": "Rate [Hz]",
    "samples": "Messwerte",
    "fitted": "angepasst",
    "left out": "ausgelassen",
    "why": "warum",
    "{name} masked in {share} %": "{name} zu {share} % ausgeblendet",
    "No fault is on record.": "Es ist kein Fehler verzeichnet.",
    "faults by experiment and channel": "Fehler nach Versuch und Kanal",
    "what was done": "was geschah",
    "count": "Anzahl",
    "a minute": "je Minute",
    "Which samples, counted from each channel's first": "Welche Messwerte, vom ersten jedes Kanals an gezählt",
    " and {rest} more": " und {rest} weitere",
    "pulse trains that the speed was taken from": "Impulsfolgen, aus denen die Drehzahl stammt",
    "pulse train": "Impulsfolge",
    "pulses a turn": "Impulse je Umdrehung",
    "shows speed up to [Hz]": "zeigt die Drehzahl bis [Hz]",
    "trains apart by [%]": "Folgen weichen ab um [%]",
    "reflectors off even places by [%]": "Reflektoren neben gleichmäßigen Plätzen um [%]",
    "{name}: operating point {point}.": "{name}: Betriebspunkt {point}.",
    "How the signals of {name} were made": "Wie die Signale von {name} entstanden",
    "how the signals of {name} were made": "wie die Signale von {name} entstanden",
    "part": "Teil",
    "account": "Bericht",
    "The verdict in full": "Das Urteil im Ganzen",
    "How well the model follows": "Wie gut das Modell folgt",
    "What the residuals say": "Was die Residuen sagen",
    "The model's outputs stay the same when these change together, in the proportion given:": (
        "Die Ausgänge des Modells bleiben gleich, wenn sich diese gemeinsam ändern, im angegebenen Verhältnis:"
    ),
    "Any one of these, known from elsewhere, would settle the rest:": (
        "Jedes davon, aus anderer Quelle bekannt, würde den Rest klären:"
    ),
    "all data": "alle Daten",
    "The model explains {share} % of the variation of the {output} (root mean square), noise included.": (
        "Das Modell erklärt {share} % der Schwankung (Effektivwert, mit Rauschen): {output}."
    ),
    "fit of each output in each experiment": "Anpassung jedes Ausgangs in jedem Versuch",
    "output": "Ausgang",
    "explained [%]": "erklärt [%]",
    "figures of all outputs together": "Kennzahlen aller Ausgänge zusammen",
    "value": "Wert",
    "mean squared error": "mittleres Fehlerquadrat",
    "deviance: minus twice the logarithm of the likelihood": "Devianz: minus zweimal der Logarithmus der Likelihood",
    "final prediction error (FPE)": "Fehler der Vorhersage (FPE)",
    "Akaike's criterion (AIC)": "Kriterium von Akaike (AIC)",
    "Akaike's criterion for few samples (AICc)": "Kriterium von Akaike für wenige Messwerte (AICc)",
    "Bayesian criterion (BIC)": "Bayessches Kriterium (BIC)",
    "consistent Akaike criterion (CAIC)": "konsistentes Kriterium von Akaike (CAIC)",
    "probability of such residuals, were the structure right (p)": (
        "Wahrscheinlichkeit solcher Residuen, wäre die Struktur richtig (p)"
    ),
    "explained by the set point of what was left [%]": "vom Rest durch den Sollwert erklärt [%]",
    "chi-squared": "Chi-Quadrat",
    "degrees of freedom": "Freiheitsgrade",
    "No residual test: what was fitted has no order in time.": (
        "Kein Test der Residuen: Was angepasst wurde, hat keine zeitliche Folge."
    ),
    "What a right model leaves over is noise: unlike the set point, or a dynamic part is missing, and, once whitened, unlike "
    "its own past, or the intervals may be too narrow (Ljung 1999, section 16.6). A test fails below p = {threshold}; on long "
    "records it finds parts that do not matter: the column of what is explained says how much.": (
        "Was ein richtiges Modell übrig lässt, ist Rauschen: dem Sollwert unähnlich, sonst fehlt Dynamik, und geweißt der eigenen "
        "Vergangenheit unähnlich, sonst sind die Bereiche vielleicht zu schmal (Ljung 1999, Abschnitt 16.6). Ein Test schlägt "
        "unter p = {threshold} an; in langen Aufzeichnungen findet er auch Unwichtiges: Die Spalte des Erklärten sagt, wie viel."
    ),
    "residual tests of each output": "Tests der Residuen jedes Ausgangs",
    "set point, p": "Sollwert, p",
    "verdict": "Urteil",
    "explains of what was left [%]": "erklärt vom Rest [%]",
    "whiteness, p": "Weißheit, p",
    "free of the set point": "frei vom Sollwert",
    "follows the set point": "folgt dem Sollwert",
    "white": "weiß",
    "coloured": "farbig",
    "{count} of {lags} lags outside the band": "{count} von {lags} Abständen außerhalb des Bandes",
    "Whitened residuals of the {output}: correlation with their own past, {own}, and with the set point, {by_set_point}. Of "
    "noise one lag in twenty is outside.": (
        "Geweißte Residuen ({output}): Korrelation mit der eigenen Vergangenheit, {own}, und mit dem Sollwert, {by_set_point}. "
        "Bei Rauschen liegt einer von zwanzig außerhalb."
    ),
    "Whitened residuals of the {output}: correlation with the set point, {by_set_point}. Of noise one lag in twenty is "
    "outside.": (
        "Geweißte Residuen ({output}): Korrelation mit dem Sollwert, {by_set_point}. Bei Rauschen liegt einer von zwanzig "
        "außerhalb."
    ),
    "Combinations of parameters": "Kombinationen von Parametern",
    "The data often determine a product, a ratio or a sum more closely than its single parameters.": (
        "Ein Produkt, ein Verhältnis oder eine Summe bestimmen die Daten oft genauer als die einzelnen Parameter."
    ),
    "An arrow: the interval ends outside, at the figure beside it.": "Ein Pfeil: Der Bereich endet außerhalb, bei der Zahl daneben.",
    "Uneven intervals also cover other models that fit as well.": (
        "Ungleichseitige Bereiche umfassen auch andere Modelle, die ebenso gut passen."
    ),
    "An element is a part of the model that may act or not, such as a dead time. It acts where its interval leaves no room"
    " for none, and is undecided where the interval reaches from none to something that would matter.": (
        "Ein Element ist ein Teil des Modells, der wirken kann oder nicht, etwa eine Totzeit. Es wirkt, wenn sein"
        " Vertrauensbereich keins ausschließt, und ist offen, wenn der Bereich von keinem bis zu einem reicht, auf das es"
        " ankäme."
    ),
    "Gain of fit by each element, as the change of the deviance. Left of the line the gain may be chance. An element "
    "right of it acts, unless the others explain as much when they are fitted together with it.": (
        "Gewinn durch jedes Element, als Änderung der Devianz. Links der Linie kann er Zufall sein. Ein Element rechts "
        "davon wirkt, wenn nicht die übrigen, gemeinsam mit ihm angepasst, ebenso viel erklären."
    ),
    "Computed from the model linearised about the operating point, for small motions.": (
        "Berechnet aus dem Modell, um den Betriebspunkt linearisiert, für kleine Bewegungen."
    ),
    "Elements absent, or too weak to show: {names}.": "Elemente, die fehlen oder zu schwach sind, um sich zu zeigen: {names}.",
    "Elements of the model": "Elemente des Modells",
    "elements of the model": "Elemente des Modells",
    "Elements that act: {names}.": "Wirkende Elemente: {names}.",
    "Elements that may act or not: {names}. The intervals cover both cases.": (
        "Elemente, die vielleicht wirken: {names}. Die Bereiche umfassen beide Fälle."
    ),
    "Figures of the model, not to be used": "Zahlen des Modells, nicht zu verwenden",
    "Gains and slopes are normalised: they relate changes in per cent of the value at the operating point.": (
        "Verstärkungen und Steigungen sind normiert: Sie beziehen Änderungen in Prozent des Werts am Betriebspunkt "
        "aufeinander."
    ),
    "Known only roughly: {names}.": "Nur grob bekannt: {names}.",
    "More excitation or another signal may help.": "Mehr Anregung oder ein weiteres Signal kann helfen.",
    "Not determined by the data: {names}.": "Von den Daten nicht bestimmt: {names}.",
    "These figures are not to be used.": "Diese Zahlen sind nicht zu verwenden.",
    "normalised": "normiert",
    "In the formulas": "In den Formeln",
    "not to be used": "nicht zu verwenden",
    "One of these would settle it, known from elsewhere (torsional calculation, factory test): {names}.": (
        "Eines davon würde es klären, aus anderer Quelle bekannt (Drehschwingungsrechnung, Prüfstand): {names}."
    ),
    "One of these, known from elsewhere (torsional calculation, factory test), would sharpen the others: {names}.": (
        "Eines davon, aus anderer Quelle bekannt (Drehschwingungsrechnung, Prüfstand), würde die übrigen schärfen: "
        "{names}."
    ),
    "Operating point: engine speed {speed} rpm, measured torque {torque} Nm.": (
        "Betriebspunkt: Motordrehzahl {speed} rpm, gemessenes Drehmoment {torque} Nm."
    ),
    "Possible causes, in the order in which to look: sensors (a channel from another recording, the side of the shaft "
    "that a gauge is on, scale, offset, delay), actuation (fuel rack, dead time, lag, limits), then gains that change, "
    "or a load that the model lacks.": (
        "Mögliche Ursachen, in der Reihenfolge der Suche: Sensoren (ein Kanal aus einer anderen Aufzeichnung, die Seite der "
        "Welle, auf der gemessen wird, Skalierung, Nullpunkt, Verzug), Verstellung (Füllung, Totzeit, Zeitkonstante, Grenzen), "
        "dann Beiwerte, die sich ändern, oder eine Last, die dem Modell fehlt."
    ),
    "The data distinguish all {free} free parameters (condition number of the scaled sensitivities {condition}).": (
        "Die Daten unterscheiden alle {free} freien Parameter (Konditionszahl der skalierten Empfindlichkeiten "
        "{condition})."
    ),
    "The data distinguish {rank} of {free} free parameters.": "Die Daten unterscheiden {rank} von {free} freien Parametern.",
    "What the data distinguish": "Was die Daten unterscheiden",
    "The drive train, with 95 % intervals": "Der Antriebsstrang, mit 95-%-Bereichen",
    "The intervals also cover other models that fit as well, and elements that were not found, each at its limit.": (
        "Die Bereiche umfassen auch andere Modelle, die ebenso gut passen, und nicht gefundene Elemente, jedes an seiner "
        "Grenze."
    ),
    "The model's answer to a step of the set point by 1 %. Dashed: the set point. Dotted: from here on the speed stays "
    "within 5 % of the step.": (
        "Antwort des Modells auf einen Sollwertsprung von 1 %. Gestrichelt: der Sollwert. Punktiert: Von hier an bleibt "
        "die Drehzahl auf 5 % des Sprungs genau."
    ),
    "These figures as CSV": "Diese Zahlen als CSV",
    "What would help: a longer recording, a larger swing of the set point, a torque channel, or a parameter known from "
    "elsewhere.": (
        "Es hilft: eine längere Aufzeichnung, ein größerer Ausschlag des Sollwerts, ein Drehmomentkanal oder ein "
        "Parameter aus anderer Quelle."
    ),
    "after a step of the set point, until the speed stays within 5 % of it": (
        "nach einem Sollwertsprung, bis die Drehzahl auf 5 % genau bleibt"
    ),
    "A load step by {step} % of the operating torque, small enough for the linearised model; which step ISO 8528-5 asks "
    "of an engine follows from its mean effective pressure, which no log tells. The last column says up to which step "
    "the class is met where no limit of torque or rate acts.": (
        "Ein Lastsprung um {step} % des Moments am Betriebspunkt, klein genug für das linearisierte Modell; welchen Sprung "
        "ISO 8528-5 von einem Motor verlangt, folgt aus seinem effektiven Mitteldruck, den keine Aufzeichnung zeigt. Die "
        "letzte Spalte sagt, bis zu welchem Sprung die Klasse erfüllt ist, wo keine Grenze des Moments oder seiner Änderung wirkt."
    ),
    "class": "Klasse",
    "speed falls by [%]": "Drehzahl fällt um [%]",
    "at most [%]": "höchstens [%]",
    "recovers within [s]": "ausgeregelt nach [s]",
    "at most [s]": "höchstens [s]",
    "result": "Ergebnis",
    "met up to a step of [%]": "erfüllt bis zu einem Sprung von [%]",
    "classes of governing by ISO 8528-5, speed after a load step": (
        "Ausführungsklassen nach ISO 8528-5, Drehzahl nach einem Lastsprung"
    ),
    "pass": "erfüllt",
    "fail": "nicht erfüllt",
    "open": "offen",
    "up to this frequency the speed follows the set point": "bis zu dieser Frequenz folgt die Drehzahl dem Sollwert",
    "growth of the gains at which the loop begins to swing": "Erhöhung der Verstärkung, bei der der Kreis zu schwingen beginnt",
    "no gain was found at which the loop swings": "keine Verstärkung gefunden, bei der der Kreis schwingt",
    "{factor} times": "{factor}-fach",
    "drive train not named": "Antriebsstrang ohne Namen",
    "undecided": "unentschieden",
    "{name}, {start} to {stop} s: measurement, and the model's answer to the same set point. Shaded: 95 % of the measured"
    " samples lie this close to the model.": (
        "{name}, {start} bis {stop} s: Messung, und die Antwort des Modells auf denselben Sollwert. Schattiert: 95 % der "
        "Messwerte liegen so nah am Modell."
    ),
    "{name}: measured signals, and the model's answer to the same set point.": (
        "{name}: gemessene Signale, und die Antwort des Modells auf denselben Sollwert."
    ),
    "set point: {kind}": "Sollwert: {kind}",
    "value of the model": "Wert des Modells",
    "v is the per cent of engine torque that 1 % more fuel rack brings. From speed and torque follow only the products "
    "vK_p and vK_i with the governor's gains K_p and K_i; a channel of the fuel rack would give v.": (
        "v sind die Prozent Motormoment, die 1 % mehr Füllung bringt. Aus Drehzahl und Drehmoment folgen nur die Produkte"
        " vK_p und vK_i mit den Beiwerten K_p und K_i des Reglers; ein Kanal der Füllung ergäbe v."
    ),
    "inertia of the whole drive train, seen from the propeller shaft [kg m²]": (
        "Trägheitsmoment des ganzen Antriebsstrangs, auf die Propellerwelle bezogen [kg m²]"
    ),
    "inertia on the propeller's side of the torque gauge [kg m²]": "Trägheitsmoment auf der Propellerseite der Momentmessung [kg m²]",
    "speed at the operating point": "Drehzahl am Betriebspunkt",
    "shaft speed at the operating point [rev/s]": "Wellendrehzahl am Betriebspunkt [Umdrehungen/s]",
    "engine speed at the operating point [rpm]": "Motordrehzahl am Betriebspunkt [rpm]",
    "engine torque at the operating point, at the shaft [Nm]": "Motormoment am Betriebspunkt, an der Welle [Nm]",
    "engine torque at the operating point [Nm]": "Motormoment am Betriebspunkt [Nm]",
    "load torque at the operating point [Nm]": "Lastmoment am Betriebspunkt [Nm]",
    "fuel rack at the operating point [mm]": "Füllung am Betriebspunkt [mm]",
    "shaft speed [rev/s]": "Wellendrehzahl [Umdrehungen/s]",
    "engine speed [rpm]": "Motordrehzahl [rpm]",
    "propeller torque [Nm]": "Propellermoment [Nm]",
    "engine torque [Nm]": "Motormoment [Nm]",
    "measured load torque [Nm]": "gemessenes Lastmoment [Nm]",
    "fuel rack [mm]": "Füllung [mm]",
    "change of the engine torque by the fuel rack, over its operating point": "Änderung des Motormoments durch die Füllung, je Betriebspunkt",
    "step of time [s]": "Zeitschritt [s]",
    "proportional gain as set in the governor [mm/rpm]": "P-Beiwert, wie im Regler eingestellt [mm/rpm]",
    "integral gain as set in the governor [mm/(rpm s)]": "I-Beiwert, wie im Regler eingestellt [mm/(rpm s)]",
    "derivative gain as set in the governor [mm s/rpm]": "D-Beiwert, wie im Regler eingestellt [mm s/rpm]",
    "torsional stiffness of the shaft [Nm/rad]": "Drehsteifigkeit der Welle [Nm/rad]",
    "variable of the Laplace transform [1/s]": "Variable der Laplace-Transformation [1/s]",
}
"""English sentence of the report to its German one."""
